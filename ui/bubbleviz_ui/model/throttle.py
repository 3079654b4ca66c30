"""Calls merged, so that any number of changes costs one update, and the rate of what was done."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from PySide6.QtCore import QObject, QTimer


class Throttle(QTimer):
    """Calls a function once for all requests within an interval; 0 ms: in this turn of the loop."""

    def __init__(self, parent: QObject, do: Callable[[], object], interval_ms: int = 0) -> None:
        super().__init__(parent, singleShot=True, interval=interval_ms)
        self.timeout.connect(do)

    def request(self, *_: object) -> None:
        """Call it at the end of the interval, which the first request begins."""
        if not self.isActive():
            self.start()


class RateMeter:
    """Events of the last second."""

    def __init__(self) -> None:
        self._times: deque[float] = deque()

    def tick(self, now_s: float) -> None:
        self._times.append(now_s)

    def rate_hz(self, now_s: float) -> float:
        """Number of events in the second that ends now."""
        while self._times and self._times[0] < now_s - 1.0:
            self._times.popleft()
        return float(len(self._times))
