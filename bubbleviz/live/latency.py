"""Latency: the age of a frame when it is shown."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from bubbleviz.frames.frame import Frame

SAME_CLOCK_NS = 5_000_000_000
"""Stamps further than this from the arrival are of another clock: age is counted from arrival."""


class LatencyReport(NamedTuple):
    """Ages of the last frames, s; `from_stamp` tells whether since the stamp, or since arrival."""

    median_s: float
    p95_s: float
    worst_s: float
    from_stamp: bool


class LatencyMeter:
    """Ages of the last `window` frames at one point of the processing."""

    def __init__(self, window: int = 600) -> None:
        self._ages: deque[float] = deque(maxlen=window)
        self._from_stamp = True

    def add(self, frame: Frame, now_ns: int) -> None:
        """Take note of a live frame that is here now."""
        self._from_stamp = abs(frame.arrival_ns - frame.stamp_ns) < SAME_CLOCK_NS
        since = frame.stamp_ns if self._from_stamp else frame.arrival_ns
        self._ages.append((now_ns - since) * 1e-9)

    @property
    def ages_s(self) -> list[float]:
        """The ages that are remembered, oldest first."""
        return list(self._ages)

    def report(self) -> LatencyReport | None:
        """Ages so far; None before the first frame."""
        if not self._ages:
            return None
        ages = np.array(self._ages)
        median, p95 = np.percentile(ages, [50.0, 95.0])
        return LatencyReport(float(median), float(p95), float(ages.max()), self._from_stamp)
