"""Mean, spread and extremes of a quantity over some frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Statistics:
    """Of the frames in which a quantity is known; in its unit, NaN where there are too few."""

    mean: float
    standard_deviation: float  # of a single frame, with n − 1 in the denominator
    minimum: float
    maximum: float
    frames: int  # in which it is known


def statistics(values: np.ndarray) -> Statistics:
    """Statistics of an array (n,); NaN is unknown."""
    known = values[np.isfinite(values)]
    if not known.size:
        return Statistics(np.nan, np.nan, np.nan, np.nan, 0)
    spread = float(known.std(ddof=1)) if known.size > 1 else np.nan
    return Statistics(
        float(known.mean()), spread, float(known.min()), float(known.max()), known.size
    )
