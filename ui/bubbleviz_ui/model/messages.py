"""Messages to the user, kept for the message log."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from PySide6.QtCore import QObject, Signal

from bubbleviz.errors import InputError

MessageKind = Literal["notice", "warning", "error"]
Warnings = dict[str, "UserMessage"]
"""Warnings by subject."""
OPENING = "opening"
"""Topic of failures to open or connect."""
SOURCE = "source"
"""Topic of failures in the open source, until another one is open."""
CALIBRATION = "calibration"
"""Topic of the calibration of the open source."""
MAX_MESSAGES = 1000
"""Bounds the memory if a source fails at every frame."""


@dataclass(frozen=True)
class UserMessage:
    """A sentence for the user."""

    kind: MessageKind
    text: str
    details: str = ""  # Traceback of a bug
    file: Path | None = None  # File or folder that was written
    at: datetime = field(default_factory=datetime.now)
    # A later success of the same topic removes an error from the message bar. Of a warning about
    # one of several sensors: its `SensorClient.prefix`
    topic: str = ""

    def line(self) -> str:
        """Time, kind and text, separated by tabs."""
        return f"{self.at:%H:%M:%S}\t{self.kind}\t{self.text}"

    def report(self) -> str:
        """The line and the details, if any."""
        return "\n".join(filter(None, (self.line(), self.details.rstrip())))


class Messages(QObject):
    """All messages of a window since it was opened."""

    added = Signal(object)  # A `UserMessage`
    # A `UserMessage` that does not hold any more, and the one in its place or None
    revised = Signal(object, object)

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self.all: deque[UserMessage] = deque(maxlen=MAX_MESSAGES)  # Oldest first

    def add(
        self,
        kind: MessageKind,
        text: str,
        details: str = "",
        *,
        file: Path | None = None,
        topic: str = "",
    ) -> UserMessage:
        """Log a message, with the fields of `UserMessage`, and emit `added`."""
        message = UserMessage(kind, text, details, file, topic=topic)
        self.all.append(message)
        self.added.emit(message)
        return message

    def revise(self, before: Warnings, texts: dict[str, str], topic: str) -> Warnings:
        """Log warnings that hold now, by subject, in place of those known before."""
        for subject in before.keys() - texts.keys():
            self.revised.emit(before[subject], None)
        return {key: self._revised(before.get(key), text, topic) for key, text in texts.items()}

    def _revised(self, message: UserMessage | None, text: str, topic: str) -> UserMessage:
        if message is None:
            return self.add("warning", text, topic=topic)
        if message.text == text:
            return message
        new = replace(message, text=text)
        logged = (new if each is message else each for each in self.all)
        self.all = deque(logged, MAX_MESSAGES)
        self.revised.emit(message, new)
        return new

    def report(self, topic: str, path: Path, write: Callable[[], str | None]) -> bool:
        """Write a file and report that, or why it failed. Returns whether the file was written.

        `write` may return a sentence in place of "Saved …".
        """
        try:
            said = write()
        except InputError as error:
            self.add("error", str(error), topic=topic)
            return False
        self.add("notice", said or f"Saved {path}", file=path, topic=topic)
        return True
