"""What the window tells its user: the one way to tell it, and all of it since the start."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

from PySide6.QtCore import QObject, Signal

MessageKind = Literal["notice", "warning", "error"]
OPENING = "opening"
"""Topic of what could not be opened or connected."""
MOST_KEPT = 1000
"""A source that fails frame after frame must not fill the memory."""


@dataclass(frozen=True)
class UserMessage:
    """A sentence for the user."""

    kind: MessageKind  # Success; done, with a reservation; failure
    text: str
    details: str = ""  # Of a bug, for a report
    file: Path | None = None  # What was written: a file or a folder
    at: datetime = field(default_factory=datetime.now)  # When it was told
    topic: str = ""  # What it is about: once that succeeds, its errors are of no interest any more

    def line(self) -> str:
        """Time, kind and text, by tabs."""
        return f"{self.at:%H:%M:%S}\t{self.kind}\t{self.text}"

    def report(self) -> str:
        """That line, with the details where there are any."""
        return "\n".join(filter(None, (self.line(), self.details.rstrip())))


class Messages(QObject):
    """All messages of a window since it was opened."""

    told = Signal(object)  # A `UserMessage`, the newest

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self.all: deque[UserMessage] = deque(maxlen=MOST_KEPT)  # The oldest first

    def tell(self, message: UserMessage) -> None:
        """Keep a message and have it shown."""
        self.all.append(message)
        self.told.emit(message)


# How often something happens, counted over the last second.


class RateMeter:
    """Events per second over a sliding window.

    `window_s`: Length of the window, s.
    """

    def __init__(self, window_s: float = 1.0) -> None:
        self._window_s = window_s
        self._times: deque[float] = deque()

    def tick(self, now_s: float) -> None:
        """Note one event."""
        self._times.append(now_s)

    def rate_hz(self, now_s: float) -> float:
        """Events per second in the window that ends now."""
        while self._times and self._times[0] < now_s - self._window_s:
            self._times.popleft()
        return len(self._times) / self._window_s
