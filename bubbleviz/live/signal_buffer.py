"""Buffer of scalar signals (gas pressure, wrench), interpolated at the time of a frame."""

from __future__ import annotations

from bisect import bisect_left, insort
from typing import NamedTuple

import numpy as np

from bubbleviz.frames.time_series import NEAREST_NS

KEPT = 2000
"""Samples kept: seconds of the fastest force sensor."""


class _Sample(NamedTuple):
    time: int
    values: np.ndarray


class Samples:
    """The last values of a topic, interpolated linearly in time.

    Attributes
    ----------
    by_arrival : bool
        Whether the topic has no stamps, so that arrivals count for it and for the frames.
    """

    def __init__(self) -> None:
        self.by_arrival = False
        self._samples: list[_Sample] = []

    def add(self, time_ns: int, values: np.ndarray) -> None:
        """Keep values of a time; a second value of the same time replaces the first."""
        k = bisect_left(self._samples, time_ns, key=lambda sample: sample.time)
        if k < len(self._samples) and self._samples[k].time == time_ns:
            self._samples[k] = _Sample(time_ns, values)
            return
        insort(self._samples, _Sample(time_ns, values), key=lambda sample: sample.time)
        if len(self._samples) > KEPT:
            del self._samples[: KEPT // 10]

    def clear(self) -> None:
        """Forget everything: the clock was set."""
        self._samples.clear()

    def covers(self, time_ns: int) -> bool:
        """Whether a value at least as new as a time arrived, or none is expected soon."""
        if not self._samples:
            return True
        newest = self._samples[-1].time
        return newest >= time_ns or newest < time_ns - 10 * NEAREST_NS

    def at(self, time_ns: int) -> np.ndarray | None:
        """Values at a time; beyond the first and the last the nearest within 0.1 s, else None."""
        samples = self._samples
        if not samples:
            return None
        k = bisect_left(samples, time_ns, key=lambda sample: sample.time)
        if 0 < k < len(samples):
            a, b = samples[k - 1], samples[k]
            weight = (time_ns - a.time) / (b.time - a.time)
            return (1.0 - weight) * a.values + weight * b.values
        nearest = samples[min(k, len(samples) - 1)]
        return nearest.values if abs(nearest.time - time_ns) <= NEAREST_NS else None
