"""Unused memory goes back to the system: images come and go for hours."""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable

from PySide6.QtCore import QObject, QTimer

from bubbleviz_ui.engine.jobs import Jobs
from bubbleviz_ui.model.session_state import SessionState

REST_MS = 3000
LIVE_EVERY_S = 10.0
"""Of a live source, which may never rest: at 60 Hz some 3 MB a second are held for nothing."""


def release_memory() -> None:
    """Have the C library let go of what it holds for nothing, where it knows how (glibc)."""
    if sys.platform.startswith("linux"):
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


class MemoryRelease(QObject):
    """Lets go of unused memory when the window has come to rest, in a thread.

    Not while a recording plays: who wants memory meanwhile waits, for longer than a picture takes.

    Parameters
    ----------
    state : SessionState
    release : callable
        Gives memory back; called in a thread.
    rest_ms : int
        How long nothing may happen before it is called.
    """

    def __init__(
        self,
        state: SessionState,
        release: Callable[[], None] = release_memory,
        rest_ms: int = REST_MS,
    ) -> None:
        super().__init__()
        self._state, self._release = state, release
        self._used, self._last_s = True, time.monotonic()
        self._jobs = Jobs("memory")
        self._timer = QTimer(self)
        self._timer.timeout.connect(lambda: self._on_tick())
        self._timer.start(rest_ms)
        for changed in (state.source_changed, state.choices_changed, state.frame_changed,
                        state.history_changed, state.playing_changed):  # fmt: skip
            changed.connect(self._on_changed)

    def close(self) -> None:
        """Look no more."""
        self._timer.stop()
        self._jobs.close()

    def _on_changed(self) -> None:
        self._used = True

    def _on_tick(self) -> None:
        facts, now = self._state.facts, time.monotonic()
        live = facts is not None and facts.live and now - self._last_s > LIVE_EVERY_S
        if self._used and (live or not self._state.playing):
            self._used, self._last_s = False, now
            self._jobs.run(lambda _: self._release())
