"""What a report says of the validation by a known press."""

from __future__ import annotations

from typing import Any

import numpy as np

from bubbleviz.calibration.validation import Validation
from bubbleviz.files.png_writer import coloured, data_uri


def validation_numbers(validation: Validation | None) -> dict[str, Any] | None:
    """Numbers for JSON, SI units; None where nothing was validated."""
    if validation is None:
        return None
    overlap = validation.patch_overlap
    return {
        "rms_m": validation.rms_m,
        "p95_m": validation.p95_m,
        "untouched_rms_m": validation.untouched_rms_m,
        "points": len(validation.distance_m),
        "patch_overlap": overlap if np.isfinite(overlap) else None,
        "predicted_force_n": validation.predicted_force_n.tolist(),
        "measured_force_n": validation.measured_force_n.tolist(),
    }


def validation_advice(validation: Validation | None) -> list[str]:
    """One sentence, or none."""
    if validation is None:
        return []
    share = validation.rms_m / max(validation.untouched_rms_m, 1e-12)
    text = (
        f"Of the known press, {1e3 * validation.untouched_rms_m:.2f} mm rms from the untouched"
        f" membrane, {1e3 * validation.rms_m:.2f} mm rms are not predicted"
    )
    if share > 0.5:
        return [f"{text}: check the pose, the object, the gauge pressure and γ0."]
    return [f"{text}."]


def validation_rows(numbers: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Rows of the table, from `validation_numbers`."""
    if numbers is None:
        return []
    overlap = numbers["patch_overlap"]
    forces = [float(np.linalg.norm(numbers[f"{k}_force_n"])) for k in ("predicted", "measured")]
    return [
        ("known press: cloud from the prediction", f"{1e3 * numbers['rms_m']:.3f} mm rms"),
        ("known press: 95 % of the points within", f"{1e3 * numbers['p95_m']:.3f} mm"),
        ("known press: from no contact", f"{1e3 * numbers['untouched_rms_m']:.3f} mm rms"),
        (
            "known press: overlap of the patches",
            "no patch" if overlap is None else f"{100 * overlap:.0f} %",
        ),
        ("known press: force predicted, estimated", f"{forces[0]:.2f} N, {forces[1]:.2f} N"),
    ]


def validation_pictures(validation: Validation | None) -> list[tuple[str, str, str]]:
    """Title, explanation and data URI of every picture."""
    if validation is None:
        return []
    distance = validation.distance_image_m
    limit = max(3.0 * validation.rms_m, 1e-9)
    patches = validation.predicted_patch + 2.0 * validation.measured_patch
    return [
        (
            "Known press: distance of the cloud",
            f"from the predicted membrane, −{1e3 * limit:.2f} mm (blue, inside) to"
            f" +{1e3 * limit:.2f} mm (red)",
            data_uri(coloured(distance, -limit, limit, True)),
        ),
        (
            "Known press: patches",
            "dark: none; then only predicted, only estimated, bright: both",
            data_uri(coloured(patches, 0.0, 3.0)),
        ),
    ]
