"""A mailbox for one frame between source and solver: a newer frame replaces an older one."""

from __future__ import annotations

import threading

from bubbleviz.frames.frame import Frame


class Mailbox:
    """Holds one frame, the newest.

    Attributes
    ----------
    skipped : int
        Frames that gave way to a newer one before anybody took them.
    """

    def __init__(self) -> None:
        self.skipped = 0
        self._frame: Frame | None = None
        self._closed = False
        self._changed = threading.Condition()

    def put(self, frame: Frame) -> None:
        """Replace what is there."""
        with self._changed:
            self.skipped += self._frame is not None
            self._frame = frame
            self._changed.notify_all()

    def take(self, timeout_s: float = 0.0) -> Frame | None:
        """The newest frame not taken yet, waiting for one; None after the timeout."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._closed, timeout_s)
            frame, self._frame = self._frame, None
            return frame

    def close(self) -> None:
        """Let go of everybody who waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
