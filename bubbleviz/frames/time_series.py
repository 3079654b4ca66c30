"""Measured values beside the depth images, at the time of a frame."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import Any

import numpy as np

from bubbleviz.frames.bags import Messages

NEAREST_NS = 100_000_000
"""Beyond the first and the last value the nearest one counts, within this time."""


class Series:
    """Values of a topic, interpolated linearly in time; read only where asked.

    Times are header stamps, or log times when `by_log` or where the topic has no stamps.
    Stamps are taken to rise; where they do not, the values around the place found count.

    Parameters
    ----------
    messages : Messages
        Not empty.
    value : callable
        Array of the values in a message; ValueError when they are not finite.
    by_log : bool
        Whether frames are timed by their log times.
    """

    def __init__(
        self, messages: Messages, value: Callable[[Any], np.ndarray], *, by_log: bool = False
    ) -> None:
        self._messages, self._value = messages, value
        self.by_log = by_log or messages.stamp_ns(0) == 0
        self._stamps: dict[int, int] = {}
        self._values: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        """Count the messages."""
        return len(self._messages)

    def at(self, stamp_ns: int, log_ns: int) -> np.ndarray | None:
        """Values at a frame's header stamp and log time (the one that applies is used).

        Beyond the first and the last message the nearest one within 0.1 s, else None.
        """
        t = log_ns if self.by_log else stamp_ns
        k = bisect_left(range(len(self)), t, key=self._time)
        if 0 < k < len(self):
            return self._between(k - 1, k, t)
        nearest = min(k, len(self) - 1)
        return self.values(nearest) if abs(self._time(nearest) - t) <= NEAREST_NS else None

    def values(self, k: int) -> np.ndarray:
        """Values of message `k`."""
        if k not in self._values:
            if len(self._values) > 10_000:
                self._values.clear()
            self._values[k] = self._value(self._messages.message(k))
        return self._values[k]

    def _time(self, k: int) -> int:
        if self.by_log:
            return int(self._messages.log_ns[k])
        if k not in self._stamps:
            self._stamps[k] = self._messages.stamp_ns(k)
        return self._stamps[k]

    def _between(self, a: int, b: int, t: int) -> np.ndarray:
        ta, tb = self._time(a), self._time(b)
        if not ta <= t <= tb or ta == tb:
            return self.values(a if abs(t - ta) <= abs(t - tb) else b)
        weight = (t - ta) / (tb - ta)
        if weight in (0.0, 1.0):  # do not read what counts nothing
            return self.values(b if weight else a)
        return (1.0 - weight) * self.values(a) + weight * self.values(b)
