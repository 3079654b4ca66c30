"""What a report says of rectification."""

from __future__ import annotations

from typing import Any

import numpy as np

from bubbleviz.calibration.identification import Identification


def rectification_numbers(found: Identification) -> dict[str, Any]:
    """Levels, and what the line through them says; an offset from one level has no limits."""
    line, mask = found.pixels.line, found.pixels.mask
    if line is None:
        return {"levels": 1}
    return {
        "levels": line.levels,
        "slope_median": float(np.median(line.slope[mask])),
        "slope_spread": float(np.std(line.slope[mask])),
        "span_median_m": float(np.median((line.farthest_m - line.nearest_m)[mask])),
    }


def rectification_rows(numbers: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of the table, from `rectification_numbers`."""
    if numbers["levels"] == 1:
        return [("rectification", "offset of each pixel, from one inflation level")]
    return [
        ("rectification", f"line of each pixel through {numbers['levels']} inflation levels"),
        (
            "true change of range per measured one",
            f"{numbers['slope_median']:.4f}, spread {numbers['slope_spread']:.4f}",
        ),
        (
            "the line holds over",
            f"{1e3 * numbers['span_median_m']:.2f} mm; beyond, the nearest level's offset",
        ),
    ]
