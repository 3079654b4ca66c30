"""Where frames lie along a timeline. No Qt in here."""

from __future__ import annotations

import numpy as np

from bubbleviz.frames.gaps import usual_step


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
        """Count the frames."""
        return len(self.places)

    def nearest(self, places: np.ndarray | float) -> np.ndarray:
        """Frames nearest to places, of any shape."""
        return np.searchsorted(self._between, places)
