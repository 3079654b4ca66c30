"""Calls that are merged, so that any number of changes costs one update."""

from __future__ import annotations

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
