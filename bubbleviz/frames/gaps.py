"""Where frames are missing in a recording, and where the others lie along its time."""

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


class TimeAxis:
    """Places of frames from 0 to 1, linear in their times.

    Where time does not go on, as in a replay that began again, a frame follows after a usual step.

    Parameters
    ----------
    times_s : (F,) array
        Time of each frame, s.

    Attributes
    ----------
    places : (F,) array
        Place of each frame.
    span_s : float
        Time from the first frame to the last, s.
    step : float
        Usual distance of one frame from the next.
    """

    def __init__(self, times_s: np.ndarray) -> None:
        steps = np.diff(times_s)
        usual_s = usual_step(steps) or 1.0
        after_s = np.zeros(len(times_s))
        np.cumsum(np.where(steps > 0, steps, usual_s), out=after_s[1:])
        self.span_s = float(after_s.max(initial=0.0))
        self.places = after_s / (self.span_s or 1.0)
        self.step = usual_s / (self.span_s or 1.0)
        self._between = 0.5 * (self.places[1:] + self.places[:-1])

    def __len__(self) -> int:
        return len(self.places)

    def nearest(self, places: np.ndarray | float) -> np.ndarray:
        """Frames nearest to places, of any shape."""
        return np.searchsorted(self._between, places)
