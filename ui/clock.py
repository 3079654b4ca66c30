"""Playback time: which frame is due now, at a speed, with or without a loop. No Qt in here."""

from __future__ import annotations

import numpy as np


class PlayClock:
    """Turns wall time into the frame that is due.

    Parameters
    ----------
    times_s : (F,) array
        Time of each frame, s.
    """

    def __init__(self, times_s: np.ndarray) -> None:
        self._times = np.asarray(times_s, dtype=float)
        self._from_s = 0.0
        self._wall_s = 0.0
        self._speed = 1.0
        self._last = 0

    @property
    def period_s(self) -> float:
        """Length of one loop: the span of the frames plus one mean interval, s."""
        span = float(self._times[-1] - self._times[0])
        return span + (span / (len(self._times) - 1) if len(self._times) > 1 else 1.0)

    def start(self, index: int, wall_s: float, speed: float) -> None:
        """Play on from frame `index`, shown at wall time `wall_s`, at a speed."""
        self._from_s = float(self._times[index] - self._times[0])
        self._wall_s = wall_s
        self._speed = speed
        self._last = index

    def due(self, wall_s: float, *, loop: bool) -> tuple[int, int, bool]:
        """Frame due now, frames skipped since the last call, and whether playback is over."""
        frames = len(self._times)
        elapsed = self._from_s + (wall_s - self._wall_s) * self._speed
        ended = not loop and elapsed >= self._times[-1] - self._times[0]
        turns, within = divmod(elapsed, self.period_s) if loop else (0.0, elapsed)
        index = int(np.searchsorted(self._times - self._times[0], within + 1e-9, "right")) - 1
        index = frames - 1 if ended else min(max(index, 0), frames - 1)
        if turns:
            self._from_s, self._wall_s = within, wall_s
        moved = index + int(turns) * frames - self._last
        self._last = index
        return index, max(moved - 1, 0), ended
