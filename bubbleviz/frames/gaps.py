"""Where frames are missing in a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gap:
    """Missing frames.

    Attributes
    ----------
    after_frame : int
        Index of the last frame before the gap.
    missing : int
        Number of frames missing there.
    duration_s : float
        Time between the frames on either side, s.
    """

    after_frame: int
    missing: int
    duration_s: float


def find_gaps(times_s: np.ndarray) -> tuple[Gap, ...]:
    """Gaps between consecutive frames.

    A step of about n + 1 periods misses n frames. A late frame is not a missing one: the steps
    beside it are short by as much, so two on either side count, less their whole periods.

    Parameters
    ----------
    times_s : (F,) array
        Time of each frame, s, not falling.
    """
    steps = np.diff(times_s)
    median = usual_step(steps)
    if median is None:
        return ()
    # unlike the median, the mean of the single steps is not biased by lateness
    period = steps[(steps > 0) & (steps < 1.5 * median)].mean()
    excess = steps / period - 1.0
    fraction = excess - np.maximum(np.rint(excess), 0.0)
    beside = np.convolve(fraction, [1, 1, 0, 1, 1])[2 : 2 + len(steps)]
    missing = np.where(excess > 0.25, np.rint(excess + beside), 0).astype(np.int64)
    return tuple(Gap(int(k), int(missing[k]), float(steps[k])) for k in np.flatnonzero(missing > 0))


def usual_step(steps: np.ndarray) -> float | None:
    """Median of the positive time steps, s; None without one."""
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None
