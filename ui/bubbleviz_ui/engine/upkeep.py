"""Upkeep of the process: garbage collection in the GUI thread, release of memory, signals.

Another thread must not delete Qt objects found in garbage: Qt may be delivering an event to one
while it waits for Python, and would crash.
"""

from __future__ import annotations

import ctypes
import gc
import mmap
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PySide6.QtCore import QCoreApplication, QObject, QTimer

from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.model.session_state import SessionState

EVERY_MS = 50


class GarbageCollector(QObject):
    """Collects garbage in the GUI thread, at Python's own thresholds.

    `application`: Owner; without its event loop no garbage is collected.
    """

    def __init__(self, application: QCoreApplication) -> None:
        super().__init__(application)
        gc.disable()
        timer = QTimer(self)
        timer.timeout.connect(_collect)
        timer.start(EVERY_MS)


def _collect() -> None:
    """Collect the oldest generation that is due, including younger ones."""
    for generation in (2, 1, 0):
        if gc.get_count()[generation] > gc.get_threshold()[generation]:
            gc.collect(generation)
            return


# Release of unused memory to the system.

TICK_MS = 1000
IDLE_TICKS = 3
"""Ticks without a change after which the window is idle."""
LARGE_BYTES = 4 << 20
"""Larger blocks are returned when freed. Images (2.5 MB of 640×480) are not: each frame needs new
ones."""
M_ARENA_MAX, M_MMAP_THRESHOLD, M_TRIM_THRESHOLD = -8, -3, -1  # of malloc.h


def limit_heaps() -> None:
    """Let all threads share two heaps, and return large blocks when freed (glibc only).

    Otherwise the heap of each thread keeps unused memory.
    """
    _call_glibc("mallopt", M_ARENA_MAX, 2)
    for threshold in (M_MMAP_THRESHOLD, M_TRIM_THRESHOLD):
        _call_glibc("mallopt", threshold, LARGE_BYTES)


def release_memory() -> None:
    """Return unused memory of the C library to the system (glibc only)."""
    _call_glibc("malloc_trim", 0)


def _call_glibc(name: str, *arguments: int) -> None:
    function = getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None
    if function is not None:
        function(*arguments)


def resident_mib() -> float:
    """Resident memory of this process, MiB; 0 where the system has no such file."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return 0.0
    return pages * mmap.PAGESIZE / 2**20


class MemoryRelease(QObject):
    """Releases unused memory when the window is idle or a source was closed, in a thread.

    Not more often: allocations block meanwhile, for longer than one picture. A closed source is a
    cycle of few objects and a hundred MB, which no threshold of garbage collection counts.
    """

    def __init__(
        self,
        state: SessionState,
        release: Callable[[], None] = release_memory,  # Called in a thread
        tick_ms: int = TICK_MS,
    ) -> None:
        super().__init__()
        self._release, self._unchanged, self._source_closed = release, 0, False
        self._worker = Worker("memory")
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._on_tick)
        self._timer.start(tick_ms)
        for changed in (state.source_changed, state.settings_changed, state.frame_changed,
                        state.history_changed, state.playing_changed):  # fmt: skip
            changed.connect(self._on_changed)
        state.source_changed.connect(self._on_source)

    def close(self) -> None:
        """Stop the timer, and ask the thread to end."""
        self._timer.stop()
        self._worker.close(0.0)

    def _on_changed(self) -> None:
        self._unchanged = 0

    def _on_source(self) -> None:
        self._source_closed = True

    def _on_tick(self) -> None:
        self._unchanged += 1
        if self._unchanged == IDLE_TICKS or self._source_closed:
            self._source_closed = False
            gc.collect()  # here, see above; milliseconds, as imported modules are frozen
            self._worker.submit(self._release)


# ^C and SIGTERM as events of the Qt event loop.

EXIT_CODE = 130
"""Exit code after ^C, as shells report it."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """Ends the Qt event loop after ^C or SIGTERM, between two events.

    A custom event loop must check `received` itself; ending Qt's loop then would end the next one.

    Python runs a signal handler at any point of the main thread, in Qt's event loop at the next
    tick of `GarbageCollector`. An exception during the import of Qt or VTK, or closing the window
    while VTK draws, would crash; so the handler, installed before these imports, only asks the loop
    to end. Ignored signals (`nohup`) stay ignored. Does nothing outside the main thread, where
    Python handles no signals.
    """

    def __init__(self) -> None:
        self.received = False
        self._former: dict[signal.Signals, Any] = {}
        self._application: QCoreApplication | None = None
        if threading.current_thread() is threading.main_thread():
            handled = [k for k in _SIGNALS if signal.getsignal(k) is not signal.SIG_IGN]
            self._former = {number: signal.signal(number, self._receive) for number in handled}

    def end(self, application: QCoreApplication) -> None:
        """End this application's event loop on the next signal."""
        self._application = application

    def close(self) -> None:
        """Restore the previous signal handlers."""
        while self._former:
            signal.signal(*self._former.popitem())

    def _receive(self, *_: object) -> None:
        self.received, application = True, self._application
        if application is not None and application.thread().loopLevel() > 0:
            application.exit(EXIT_CODE)
