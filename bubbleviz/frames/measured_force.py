"""The size of the force that a wrench sensor beside the bubble measured."""

from __future__ import annotations

import numpy as np


def measured_force(wrench_n: np.ndarray, contact_free: np.ndarray) -> np.ndarray:
    """|F| of recorded wrenches less their bias, N.

    The axes of a force/torque sensor are rarely documented, so only the size can be compared. Its
    bias is the median over the contact-free frames.

    Parameters
    ----------
    wrench_n : (F, 3) array
        Forces as recorded, N; NaN where a frame has none.
    contact_free : (F,) bool array

    Returns
    -------
    (F,) array
        NaN for frames without a wrench, and for all where no contact-free frame has one.
    """
    free = wrench_n[contact_free & np.isfinite(wrench_n).all(axis=1)]
    bias = np.median(free, axis=0) if len(free) else np.full(3, np.nan)
    return np.asarray(np.linalg.norm(wrench_n - bias, axis=1))


def force_of(wrench: np.ndarray | None) -> np.ndarray:
    """Force (3,) of a frame's wrench (6,), N; NaN without one."""
    return np.full(3, np.nan) if wrench is None else np.asarray(wrench[:3], float)
