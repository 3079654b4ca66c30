"""What RESULT.npz and RESULT.csv say of traction with friction and slip."""

from __future__ import annotations

from typing import Any

import numpy as np

from bubbleviz.diagnostics.shear_numbers import ShearNumbers
from bubbleviz.result import Result


def by_axis(*keys: str) -> dict[str, tuple[str, ...]]:
    """Keys of vectors, `force_n`, with their columns by component, `force_x_n` and so on."""
    parts = {key: key.rpartition("_") for key in keys}
    return {key: tuple(f"{p[0]}_{axis}_{p[2]}" for axis in "xyz") for key, p in parts.items()}


SHEAR_COLUMNS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("traction_status", "traction_reason"), ()),
    **by_axis(
        *("traction_force_n", "traction_force_sigma_n"),
        *("traction_torque_nm", "traction_torque_sigma_nm"),
    ),
    **dict.fromkeys(("flow_rms_px", "slip", "slip_sigma"), ()),
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
