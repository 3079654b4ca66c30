"""Garbage is looked for in the GUI thread only: another one may not delete Qt objects found in it.

Qt may be handing an event to such an object while it waits for Python, and crashes.
"""

from __future__ import annotations

import ctypes
import gc
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable

from PySide6.QtCore import QCoreApplication, QObject, QTimer

from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.model.session_state import SessionState

EVERY_MS = 50


class GarbageCollector(QObject):
    """Does what Python would do in whichever thread makes an object, as often as Python would.

    `application`: Keeps the collector; garbage stays where its event loop does not run.
    """

    def __init__(self, application: QCoreApplication) -> None:
        super().__init__(application)
        gc.disable()
        timer = QTimer(self)
        timer.timeout.connect(_collect)
        timer.start(EVERY_MS)


def _collect() -> None:
    """Collect the oldest generation that is due, and the younger ones with it."""
    for generation in (2, 1, 0):
        if gc.get_count()[generation] > gc.get_threshold()[generation]:
            gc.collect(generation)
            return


# Unused memory goes back to the system: images come and go for hours.


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
    """

    def __init__(
        self,
        state: SessionState,
        release: Callable[[], None] = release_memory,  # Gives memory back; called in a thread
        rest_ms: int = REST_MS,  # How long nothing may happen before it is called
    ) -> None:
        super().__init__()
        self._state, self._release = state, release
        self._used, self._last_s = True, time.monotonic()
        self._worker = Worker("memory")
        self._timer = QTimer(self)
        self._timer.timeout.connect(lambda: self._on_tick())
        self._timer.start(rest_ms)
        for changed in (state.source_changed, state.settings_changed, state.frame_changed,
                        state.history_changed, state.playing_changed):  # fmt: skip
            changed.connect(self._on_changed)

    def close(self) -> None:
        """Look no more."""
        self._timer.stop()
        self._worker.close()

    def _on_changed(self) -> None:
        self._used = True

    def _on_tick(self) -> None:
        facts, now = self._state.facts, time.monotonic()
        live = facts is not None and facts.live and now - self._last_s > LIVE_EVERY_S
        if self._used and (live or not self._state.playing):
            self._used, self._last_s = False, now
            self._worker.submit(self._release)


# ^C and SIGTERM as events of Qt's event loop.


EXIT_CODE = 130
"""What shells report of a program that ^C ended."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Ends the event loop that runs after ^C or SIGTERM, between two events.

    Without one nothing is ended: whoever handles events by a loop of one's own looks at `came`. Qt
    would remember it, and end the loop that runs next.

    Python runs a signal handler wherever the main thread happens to be. An exception in the middle
    of an import of Qt or VTK, or a window that is closed while VTK draws, ends in a crash. So the
    handler only remembers it, from before these are imported on; Python also writes a byte to a
    socket, which wakes the event loop up. Signals that are ignored (`nohup`) stay ignored. Does
    nothing outside the main thread, where Python handles no signals.
    """

    def __init__(self) -> None:
        self.came = False  # Whether there was one
        self._former: dict[signal.Signals, object] = {}
        handled = [k for k in _SIGNALS if signal.getsignal(k) is not signal.SIG_IGN]
        if not handled or threading.current_thread() is not threading.main_thread():
            return
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)
        self._former_fd = signal.set_wakeup_fd(self._write.fileno(), warn_on_full_buffer=False)
        self._former = {number: signal.signal(number, self._remember) for number in handled}

    def end(self, application: QCoreApplication) -> None:
        """From now on, end this application's event loop."""
        from PySide6.QtCore import QSocketNotifier  # the handlers are there before Qt is

        if not self._former:
            return
        self._application = application
        self._notifier = QSocketNotifier(self._read.fileno(), QSocketNotifier.Type.Read)
        self._notifier.activated.connect(self._wake)

    def close(self) -> None:
        """Give the signals back to who had them."""
        if not self._former:
            return
        for number, handler in self._former.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self._former = {}
        signal.set_wakeup_fd(self._former_fd)
        self._notifier.setEnabled(False)
        self._read.close()
        self._write.close()

    def _remember(self, *_: object) -> None:
        self.came = True

    def _wake(self) -> None:
        self._read.recv(64)  # Python runs the handler before this line
        if self.came and self._application.thread().loopLevel() > 0:
            self._application.exit(EXIT_CODE)
