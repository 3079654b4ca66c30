"""Playback time: which frame is due now, at a speed, with or without a loop. No Qt in here."""

from __future__ import annotations

import numpy as np


class PlayClock:
    """Turns wall time into the frame that is due.

    Parameters
    ----------
    times_s : (F,) array
        Time of each frame, s.
    frames : (int, int), optional
        First and last frame to play; None for all.
    """

    def __init__(self, times_s: np.ndarray, frames: tuple[int, int] | None = None) -> None:
        times = np.asarray(times_s, dtype=float)
        self._times = times - times[0]
        self._first, self._end = frames or (0, len(times) - 1)
        self._from_s = 0.0
        self._wall_s = 0.0
        self._speed = 1.0
        self._last = 0

    @property
    def period_s(self) -> float:
        """Length of one loop: the span of the frames plus one mean interval, s."""
        span = float(self._times[self._end] - self._times[self._first])
        return span + (span / (self._end - self._first) if self._end > self._first else 1.0)

    def start(self, index: int, wall_s: float, speed: float) -> None:
        """Play on from frame `index`, shown at wall time `wall_s`, at a speed."""
        self._last = min(max(index, self._first), self._end)
        self._from_s = float(self._times[self._last])
        self._wall_s = wall_s
        self._speed = speed

    def due(self, wall_s: float, *, loop: bool) -> tuple[int, int, bool]:
        """Frame due now, frames skipped since the last call, and whether playback is over."""
        begin, end = float(self._times[self._first]), float(self._times[self._end])
        elapsed = self._from_s + (wall_s - self._wall_s) * self._speed
        ended = not loop and elapsed >= end
        turns, within = divmod(elapsed - begin, self.period_s) if loop else (0.0, elapsed - begin)
        index = int(np.searchsorted(self._times, begin + within + 1e-9, "right")) - 1
        index = self._end if ended else min(max(index, self._first), self._end)
        if turns:
            self._from_s, self._wall_s = begin + within, wall_s
        moved = index + int(turns) * (self._end - self._first + 1) - self._last
        self._last = index
        return index, max(moved - 1, 0), ended

    def following(self, wall_s: float, *, loop: bool) -> tuple[int, bool]:
        """One frame on, where it is due, and whether playback is over; late is not made up for."""
        if self._last >= self._end:
            if not loop:
                return self._last, True
            index, interval = self._first, self.period_s - self._span(self._first, self._end)
        else:
            index = self._last + 1
            interval = self._span(self._last, index)
        due = self._wall_s + interval / self._speed
        if wall_s < due:
            return self._last, False
        in_time = wall_s - due < interval / self._speed
        self.start(index, due if in_time else wall_s, self._speed)
        return index, False

    def _span(self, first: int, last: int) -> float:
        return float(self._times[last] - self._times[first])
