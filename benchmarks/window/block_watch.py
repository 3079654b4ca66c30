"""Stack samples of the GUI thread while it does not process events."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from PySide6.QtCore import QTimer

BLOCKED_S = 0.1  # without events for this long, the thread's stack is sampled
BEAT_MS = 10
CALLS_TOLD = 12


class BlockWatch:
    """Samples the stack of a thread whenever it has handled no event for a while.

    Attributes
    ----------
    longest_s : float
        Longest sampled time between two beats of the thread's event loop.
    stack : str
        The innermost calls of the thread in that time, outermost first; empty without one.
    """

    def __init__(self) -> None:
        self.longest_s, self.stack = 0.0, ""
        self._watched = threading.get_ident()
        self._beat_s = time.perf_counter()
        self._seen: tuple[float, str] | None = None

    @contextmanager
    def watching(self) -> Iterator[BlockWatch]:
        """Watch the calling thread, which runs an event loop meanwhile."""
        timer, stop = QTimer(), threading.Event()
        thread = threading.Thread(target=self._sample, args=(stop,), name="watch", daemon=True)
        self._beat_s = time.perf_counter()
        timer.timeout.connect(self._beat)
        timer.start(BEAT_MS)
        thread.start()
        try:
            yield self
        finally:
            timer.stop()
            stop.set()
            thread.join()
            self._beat()

    def _beat(self) -> None:
        now_s, seen = time.perf_counter(), self._seen
        if seen is not None and seen[0] == self._beat_s and now_s - self._beat_s > self.longest_s:
            self.longest_s, self.stack = now_s - self._beat_s, seen[1]
        self._beat_s = now_s

    def _sample(self, stop: threading.Event) -> None:
        while not stop.wait(BLOCKED_S / 2):
            since_s, seen = self._beat_s, self._seen
            known = seen is not None and seen[0] == since_s
            if not known and time.perf_counter() - since_s > BLOCKED_S:
                frame = sys._current_frames().get(self._watched)
                calls = traceback.extract_stack(frame)[-CALLS_TOLD:]
                self._seen = since_s, "".join(traceback.format_list(calls))
