"""What RESULT.npz and RESULT.csv say of traction with friction and slip."""

from __future__ import annotations

from typing import Any

import numpy as np

from bubbleviz.diagnostics.shear_numbers import ShearNumbers
from bubbleviz.result import Result

SHEAR_COLUMNS: dict[str, tuple[str, ...]] = {
    "traction_status": (),
    "traction_reason": (),
    **{
        f"traction_{name}_{unit}": tuple(f"traction_{name}_{axis}_{unit}" for axis in "xyz")
        for name, unit in (
            ("force", "n"),
            ("force_sigma", "n"),
            ("torque", "nm"),
            ("torque_sigma", "nm"),
        )
    },
    "flow_rms_px": (),
    "slip": (),
    "slip_sigma": (),
}
"""Keys with a text or a few numbers a frame, and their columns in the CSV as of
`result_writer.COLUMNS`."""

SHEAR_FIELDS: dict[str, tuple[int, ...]] = {"traction_pa": (3,), "tangential_displacement_m": (3,)}
"""Keys with three numbers per frame and node."""


def shear_row(result: Result) -> dict[str, Any]:
    """Values of one frame by key of `SHEAR_COLUMNS`; empty where traction was not asked for.

    NaN where nothing is known: σ of a traction by depth alone, slip without a patch that sticks.
    `traction_half_width_n`, half of the 95 % interval of |force|, is for a summary of the frames.
    """
    traction, slip = result.traction, result.slip
    if traction is None:
        return {}
    return {
        "traction_status": traction.status,
        "traction_reason": traction.reason,
        "traction_force_n": traction.force_n,
        "traction_force_sigma_n": traction.force_sigma_n,
        "traction_torque_nm": traction.torque_nm,
        "traction_torque_sigma_nm": traction.torque_sigma_nm,
        "traction_half_width_n": ShearNumbers.of(traction).force_n[1],
        "flow_rms_px": traction.flow_rms_px,
        "slip": np.nan if slip is None else slip.share,
        "slip_sigma": np.nan if slip is None else slip.share_sigma,
    }


def shear_fields(result: Result) -> dict[str, np.ndarray]:
    """Fields of one frame by key of `SHEAR_FIELDS`; empty where traction was not asked for."""
    traction = result.traction
    if traction is None:
        return {}
    return {
        "traction_pa": traction.traction_pa,
        "tangential_displacement_m": traction.tangential_displacement_m,
    }
