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
        self._closed = self._woken = False
        self._changed = threading.Condition()

    def put(self, frame: Frame) -> None:
        """Replace what is there."""
        with self._changed:
            self.skipped += self._frame is not None
            self._frame = frame
            self._changed.notify_all()

    def take(self, timeout_s: float = 0.0) -> Frame | None:
        """The newest frame not taken yet, waiting for one; None after the timeout, or `wake`."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._frame is not None or self._closed or self._woken, timeout_s
            )
            frame, self._frame = self._frame, None
            return frame

    def wake(self) -> None:
        """Have nobody wait until `woken` is asked."""
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def woken(self) -> bool:
        """Whether there was a `wake` since this was asked last."""
        with self._changed:
            woken, self._woken = self._woken, False
            return woken

    def close(self) -> None:
        """Let go of everybody who waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
