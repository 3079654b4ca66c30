"""A thread that runs the latest function submitted under each key; the window never waits."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from threading import Condition, Thread
from typing import Any

from PySide6.QtCore import QCoreApplication, QObject, Qt, Signal

from bubbleviz.errors import InputError
from bubbleviz.progress import Cancelled
from bubbleviz_ui.engine.jobs import PATIENCE_S

KEYS = (
    "open",
    "follow",
    "collect",
    "patch",
    "frame",
    "newest",
    "settle",
    "compare",
    "analyse",
)
"""Most urgent first."""


class Deferred(Exception):  # noqa: N818 - not an error
    """Raised by a function that is to run again after the more urgent ones."""


@dataclass(frozen=True)
class Failed:
    """A function that failed: one line for the user, and the traceback if it is a bug.

    A `warning` came with an answer. `request` is the one given to `Worker.submit`.
    """

    key: str
    message: str
    details: str = ""
    warning: bool = False
    request: object = None


@dataclass(frozen=True, eq=False)
class _Job:
    key: str
    function: Callable[[], Any]
    then: Callable[[Any], None]
    due_s: float
    request: object
    generation: int


class Worker(QObject):
    """Runs submitted functions in its own thread.

    A successful "open" starts a new generation. Functions submitted before its answer was
    delivered are dropped, as they were meant for the previous source.

    `at_end`: Called last in the thread.
    """

    failed = Signal(object)  # A `Failed`
    _ready = Signal(object)

    def __init__(self, at_end: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self.dropped = 0  # Frames replaced by a newer one before their turn
        self._slots: dict[str, _Job] = {}
        self._changed = Condition()
        self._generation = self._running = 0  # in the GUI thread, and in this one
        self._closed = False
        self._at_end = at_end
        self._ready.connect(self._deliver, Qt.ConnectionType.QueuedConnection)
        self._thread = Thread(target=self._run, name="solver", daemon=True)
        self._thread.start()

    def submit(
        self,
        key: str,  # One of `KEYS`
        function: Callable[[], Any],  # Runs in the thread
        then: Callable[[Any], None],  # Gets its return value in the GUI thread
        *,
        due_s: float = 0.0,  # Earliest start, by `time.perf_counter`
        request: object = None,  # Passed on in a `Failed`
    ) -> None:
        """Run a function instead of the one that waits under the same key.

        A "frame" also replaces a waiting "settle", because the user has left that frame.
        """
        job = _Job(key, function, then, due_s, request, self._generation)
        with self._changed:
            if key == "frame":
                self.dropped += key in self._slots
                self._slots.pop("settle", None)
            self._slots[key] = job
            self._changed.notify()

    def urgent(self, key: str) -> bool:
        """Whether something more urgent than this key waits."""
        return any(k in self._slots for k in KEYS[: KEYS.index(key)])

    def close(self, timeout_s: float = PATIENCE_S) -> None:
        """Stop the thread after the function that runs now."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self.wait(timeout_s)

    @property
    def running(self) -> bool:
        """Whether the thread has not ended yet."""
        return self._thread.is_alive()

    def wait(self, timeout_s: float = PATIENCE_S) -> None:
        """Wait for the thread to end after `close`.

        A process that ends before its threads frees what they work with: SciPy's factorisations
        then fail, and the exit code is lost (scipy#25404).
        """
        self._thread.join(timeout_s)
        if self.running:  # or it would be the last to hold this object, and delete it there
            self.setParent(QCoreApplication.instance())

    def _run(self) -> None:
        while self._serve(self._take()):
            pass
        self._at_end()

    def _take(self) -> _Job | None:
        """Wait for the most urgent function that is due; None once closed."""
        with self._changed:
            while not self._closed:
                job = next((self._slots[key] for key in KEYS if key in self._slots), None)
                wait_s = None if job is None else job.due_s - time.perf_counter()
                if job is not None and wait_s is not None and wait_s <= 0.0:
                    return self._slots.pop(job.key)
                self._changed.wait(wait_s)
        return None

    def _serve(self, job: _Job | None) -> bool:
        """Run a function and deliver what it returns; False for the end."""
        if job is None:
            return False
        if job.key != "open" and (job.generation != self._running or not self._running):
            return True
        try:
            answer = job.function()
        except Deferred:
            with self._changed:
                self._slots.setdefault(job.key, job)
        except Cancelled:
            pass
        except InputError as error:
            failed = Failed(job.key, str(error), request=job.request)
            self._ready.emit(partial(self.failed.emit, failed))
        except Exception as error:
            words = f"{type(error).__name__}: {error}".splitlines()[0][:300]
            failed = Failed(job.key, words, traceback.format_exc(), request=job.request)
            self._ready.emit(partial(self.failed.emit, failed))
        else:
            if job.key == "open":
                self._running += 1
                self._ready.emit(partial(self._renew, self._running))
            self._ready.emit(partial(job.then, answer))
        return True

    def _renew(self, generation: int) -> None:
        self._generation = generation

    def _deliver(self, call: Callable[[], None]) -> None:
        if not self._closed:
            call()
