"""Worker thread with priorities, progress and cancellation."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from threading import Condition
from typing import Any

from PySide6.QtCore import QCoreApplication, QObject, Qt, Signal, Slot

from bubbleviz.errors import InputError, SolveError
from bubbleviz.progress import Cancelled

OPEN = "open"
KEYS = (
    OPEN, "warnings", "object", "reference", "patch", "frame", "newest", "cold_solve", "compare",
    "wrench", "scale", "analyse",
)  # fmt: skip
"""Jobs of the solver thread, most urgent first."""
PROGRESS_EVERY_S = 0.05
CLOSE_TIMEOUT_S = 10.0
"""How long closing a window waits for steps that cannot be interrupted."""


class Deferred(Exception):  # noqa: N818 - not an error
    """Raised by a function to run again after more urgent ones."""


@dataclass(frozen=True)
class Failed:
    """A failed function: one line for the user, and the traceback if it is a bug.

    `request` is the one given to `Worker.submit`.
    """

    key: str
    message: str
    details: str = ""
    request: object = None
    error: Exception | None = field(default=None, compare=False)


def _ignore(_: Any) -> None:
    pass


@dataclass(frozen=True, eq=False)
class _Job:
    function: Callable[[], Any]
    then: Callable[[Any], None]
    failed: Callable[[Failed], None]
    discard: Callable[[Any], None]
    key: str
    due_s: float
    request: object
    generation: int


class Worker(QObject):
    """Runs submitted functions one after the other in its own thread, started on demand.

    With `keys` the most urgent runs first, and of each key only the latest. A successful `OPEN`
    starts a new generation: functions submitted before its result was delivered are dropped, as
    they were meant for the previous source.
    """

    progressed = Signal(str, float)  # Description of the step, and its completed share
    failed = Signal(object)  # A `Failed` of a function submitted without `failed`
    _ready = Signal(object)

    def __init__(
        self,
        name: str,
        keys: tuple[str, ...] = (),  # Most urgent first; empty: first in, first out
        at_end: Callable[[], None] = lambda: None,  # Called in the thread before it ends
    ) -> None:
        super().__init__()
        self._name, self._keys, self._at_end = name, keys, at_end
        self._waiting: list[_Job] = []
        self._wanted: set[_Job] = set()
        self._job: _Job | None = None
        self._progress_s = 0.0
        self._changed = Condition()
        self._generation = self._running = 0  # in the GUI thread, and in this one
        self._executor: ThreadPoolExecutor | None = None
        self._end: Future[None] | None = None
        self._ready.connect(self._deliver, Qt.ConnectionType.QueuedConnection)

    @property
    def busy(self) -> bool:
        """Whether a function that was not cancelled is running or waiting."""
        return bool(self._wanted)

    def submit(
        self,
        function: Callable[[], Any],  # Runs in the thread
        then: Callable[[Any], None] = _ignore,  # Receives its return value in the GUI thread
        failed: Callable[[Failed], None] | None = None,  # Receives a failure in the GUI thread
        *,
        key: str = "",  # One of `keys`, if there are any
        discard: Callable[[Any], None] = _ignore,  # Releases the return value of a cancelled call
        due_s: float = 0.0,  # Earliest start, by `time.perf_counter`
        request: object = None,  # Passed on in a `Failed`
    ) -> bool:
        """Run a function; returns whether it replaces a waiting one of the same key."""
        if self._end is not None:
            return False
        failed = failed or self.failed.emit
        job = _Job(function, then, failed, discard, key, due_s, request, self._generation)
        replaced = bool(self._keys) and self.drop(key)
        with self._changed:
            self._waiting.append(job)
            self._wanted.add(job)
            self._changed.notify()
        if self._executor is None:
            self._executor = ThreadPoolExecutor(1, self._name)
        self._executor.submit(self._serve)
        return replaced

    def drop(self, key: str) -> bool:
        """Drop the waiting function of a key; returns whether there was one."""
        with self._changed:
            dropped = [job for job in self._waiting if job.key == key]
            self._waiting = [job for job in self._waiting if job.key != key]
            self._wanted.difference_update(dropped)
        return bool(dropped)

    def cancel(self) -> None:
        """Cancel all functions; their results are not delivered."""
        with self._changed:
            self._waiting.clear()
            self._wanted.clear()
            self._changed.notify()

    def has_more_urgent(self, key: str) -> bool:
        """Whether a more urgent function than those of this key is waiting."""
        return any(self._rank(job) < self._keys.index(key) for job in self._waiting)

    def progress(self, step: str, done: float) -> None:
        """Report progress of the calling function; raises `Cancelled` if it was cancelled."""
        job = self._job
        if job not in self._wanted:
            raise Cancelled
        now = time.monotonic()
        if now - self._progress_s >= PROGRESS_EVERY_S:
            self._progress_s = now
            self._ready.emit(partial(self._show_progress, job, step, done))

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> bool:
        """Finish all functions and end the thread; returns whether it has ended in time.

        With keys, waiting functions are cancelled. A function that takes longer continues, and the
        process waits for it at exit: SciPy factorisations in a thread still running then would
        change the exit code (scipy#25404).
        """
        if self._keys:
            self.cancel()
        if self._executor is None:
            return True
        if self._end is None:
            self._end = self._executor.submit(self._finish)
        ended = bool(wait([self._end], timeout_s).done)
        self._executor.shutdown(wait=ended)
        # a running thread may hold the last reference and would delete this object
        self.setParent(None if ended else QCoreApplication.instance())
        return ended

    # -- in the thread ------------------------------------------------------------------------

    def _finish(self) -> None:
        try:
            self._at_end()
        finally:
            self._ready.emit(self.close)

    def _rank(self, job: _Job) -> int:
        return self._keys.index(job.key) if self._keys else 0

    def _take(self) -> _Job | None:
        """Wait until the most urgent function is due; None if none is left."""
        with self._changed:
            while self._waiting:
                job = min(self._waiting, key=self._rank)
                wait_s = job.due_s - time.perf_counter()
                if wait_s <= 0.0:
                    self._waiting.remove(job)
                    return job
                self._changed.wait(wait_s)
        return None

    def _serve(self) -> None:
        job = self._take()
        if job is None:
            return
        if job.key in self._keys[1:] and not 0 < job.generation == self._running:
            self._wanted.discard(job)  # it was meant for the previous source
            return
        self._job, self._progress_s = job, 0.0
        try:
            answer = job.function()
        except Deferred:
            self._defer(job)
        except Cancelled:
            self._wanted.discard(job)
        except (InputError, SolveError, OSError) as error:
            self._fail(job, str(error), error=error)
        except Exception as error:
            words = f"{type(error).__name__}: {error}".splitlines()[0][:300]
            self._fail(job, words, traceback.format_exc())
        else:
            self._running += job.key == OPEN
            if job in self._wanted:
                # in one call: nothing may be submitted between a new source and its result
                self._ready.emit(partial(self._succeed, job, answer, self._running))
            else:
                self._ready.emit(partial(self._start_generation, self._running))
                job.discard(answer)
        finally:
            self._job = None  # it refers to what waits for its result

    def _defer(self, job: _Job) -> None:
        with self._changed:
            again = job in self._wanted and all(job.key != other.key for other in self._waiting)
            if again:
                self._waiting.append(job)
        if again and self._executor is not None:
            self._executor.submit(self._serve)

    def _fail(
        self, job: _Job, message: str, details: str = "", error: Exception | None = None
    ) -> None:
        failed = Failed(job.key, message, details, request=job.request, error=error)
        self._ready.emit(partial(self._report_failure, job, failed))

    # -- in the GUI thread --------------------------------------------------------------------

    @Slot(object)  # else PySide makes a meta-object at run time, which the thread would share
    def _deliver(self, call: Callable[[], None]) -> None:
        call()

    def _start_generation(self, generation: int) -> None:
        self._generation = generation

    def _show_progress(self, job: _Job, step: str, share: float) -> None:
        if job in self._wanted:
            self.progressed.emit(step, share)

    def _report_failure(self, job: _Job, failed: Failed) -> None:
        if job in self._wanted:
            self._wanted.discard(job)
            job.failed(failed)

    def _succeed(self, job: _Job, answer: Any, generation: int) -> None:
        self._start_generation(generation)
        if job in self._wanted:
            self._wanted.discard(job)
            job.then(answer)
        else:
            job.discard(answer)


def wait_until_ended(timeout_s: float = CLOSE_TIMEOUT_S) -> bool:
    """Wait for all workers that were closed but had not ended; whether they now have."""
    application, end_s = QCoreApplication.instance(), time.monotonic() + timeout_s
    workers = [] if application is None else application.findChildren(Worker)
    ended = [worker.close(max(end_s - time.monotonic(), 0.0)) for worker in workers]
    return all(ended)
