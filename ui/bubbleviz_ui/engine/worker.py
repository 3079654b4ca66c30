"""A thread for what the window must not wait for: its functions, their progress and their ends."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from threading import Condition
from typing import Any

from PySide6.QtCore import QCoreApplication, QObject, Qt, Signal

from bubbleviz.errors import InputError, SolveError
from bubbleviz.progress import Cancelled

OPEN = "open"
KEYS = (OPEN, "follow", "collect", "patch", "frame", "newest", "settle", "compare", "analyse")
"""Of what the solver's thread does, most urgent first."""
TELL_EVERY_S = 0.05
"""Nobody reads faster."""
PATIENCE_S = 10.0
"""How long a window that closes waits for a step that cannot be interrupted; chosen."""


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


def _ignore(_: Any) -> None:
    """Nothing is to be done."""


@dataclass(frozen=True, eq=False)
class _Job:
    function: Callable[[], Any]
    then: Callable[[Any], None]
    failed: Callable[[Failed], None]
    unwanted: Callable[[Any], None]
    key: str
    due_s: float
    request: object
    generation: int


class Worker(QObject):
    """Runs submitted functions in its own thread, which is made with the first.

    One after the other; with `keys` the most urgent first, and of each key only the latest.
    A successful `OPEN` starts a new generation then: what was submitted before its answer was
    delivered is dropped, as it was meant for the previous source.
    """

    progressed = Signal(str, float)  # Step in plain words, and the share of it that is done
    failed = Signal(object)  # A `Failed` that nobody else is told
    _ready = Signal(object)

    def __init__(
        self,
        name: str,
        keys: tuple[str, ...] = (),  # Most urgent first; empty: in order, and nothing is replaced
        at_end: Callable[[], None] = lambda: None,  # Called last in the thread
    ) -> None:
        super().__init__()
        self._name, self._keys, self._at_end = name, keys, at_end
        self._waiting: list[_Job] = []
        self._wanted: set[_Job] = set()
        self._job: _Job | None = None
        self._told_s = 0.0
        self._changed = Condition()
        self._generation = self._running = 0  # in the GUI thread, and in this one
        self._executor: ThreadPoolExecutor | None = None
        self._end: Future[None] | None = None
        self._ready.connect(self._deliver, Qt.ConnectionType.QueuedConnection)

    @property
    def busy(self) -> bool:
        """A function runs or waits whose end is still wanted."""
        return bool(self._wanted)

    def submit(
        self,
        function: Callable[[], Any],  # Runs in the thread
        then: Callable[[Any], None] = _ignore,  # Gets its return value in the GUI thread
        failed: Callable[[Failed], None] | None = None,  # Is told there why there is none
        *,
        key: str = "",  # One of the keys, where there are some
        unwanted: Callable[[Any], None] = _ignore,  # Lets go of an answer that comes too late
        due_s: float = 0.0,  # Earliest start, by `time.perf_counter`
        request: object = None,  # Passed on in a `Failed`
    ) -> bool:
        """Run a function; whether it replaces one that waits under the same key."""
        if self._end is not None:
            return False
        failed = failed or self.failed.emit
        job = _Job(function, then, failed, unwanted, key, due_s, request, self._generation)
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
        """Forget what waits under a key; whether something did."""
        with self._changed:
            dropped = [job for job in self._waiting if job.key == key]
            self._waiting = [job for job in self._waiting if job.key != key]
            self._wanted.difference_update(dropped)
        return bool(dropped)

    def cancel(self) -> None:
        """Stop everything; nothing more is heard of it."""
        with self._changed:
            self._waiting.clear()
            self._wanted.clear()
            self._changed.notify()

    def urgent(self, key: str) -> bool:
        """Whether something more urgent than this key waits."""
        return any(self._rank(job) < self._keys.index(key) for job in self._waiting)

    def progress(self, step: str, done: float) -> None:
        """Tell how far the function is that calls this; it raises `Cancelled` if nobody waits."""
        job = self._job
        if job not in self._wanted:
            raise Cancelled
        now = time.monotonic()
        if now - self._told_s >= TELL_EVERY_S:
            self._told_s = now
            self._ready.emit(partial(self._tell, job, step, done))

    def close(self, timeout_s: float = PATIENCE_S) -> bool:
        """Wait until all that is wanted is done, and end the thread; whether it has ended.

        With keys nothing is wanted but what runs now. A function that takes longer goes on, and the
        process waits for it before it ends: SciPy's factorisations of a thread that is still there
        would change the exit code (scipy#25404).
        """
        if self._keys:
            self.cancel()
        if self._executor is None:
            return True
        if self._end is None:
            self._end = self._executor.submit(self._at_end)
        ended = bool(wait([self._end], timeout_s).done)
        self._executor.shutdown(wait=ended)
        if not ended:  # or the thread would be the last to hold this object, and delete it there
            self.setParent(QCoreApplication.instance())
        return ended

    # -- in the thread ------------------------------------------------------------------------

    def _rank(self, job: _Job) -> int:
        return self._keys.index(job.key) if self._keys else 0

    def _take(self) -> _Job | None:
        """Wait for the most urgent function to be due; None where there is none any more."""
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
        if job is None or self._is_stale(job):
            return
        self._job, self._told_s = job, 0.0
        try:
            answer = job.function()
        except Deferred:
            self._defer(job)
        except Cancelled:
            self._wanted.discard(job)
        except (InputError, SolveError, OSError) as error:
            self._fail(job, str(error))
        except Exception as error:
            words = f"{type(error).__name__}: {error}".splitlines()[0][:300]
            self._fail(job, words, traceback.format_exc())
        else:
            if job.key == OPEN:
                self._running += 1
                self._ready.emit(partial(self._renew, self._running))
            if job in self._wanted:
                self._ready.emit(partial(self._over, job, answer))
            else:
                job.unwanted(answer)

    def _is_stale(self, job: _Job) -> bool:
        stale = job.key in self._keys[1:] and not 0 < job.generation == self._running
        if stale:
            self._wanted.discard(job)
        return stale

    def _defer(self, job: _Job) -> None:
        with self._changed:
            again = job in self._wanted and all(job.key != other.key for other in self._waiting)
            if again:
                self._waiting.append(job)
        if again and self._executor is not None:
            self._executor.submit(self._serve)

    def _fail(self, job: _Job, message: str, details: str = "") -> None:
        failed = Failed(job.key, message, details, request=job.request)
        self._ready.emit(partial(self._refuse, job, failed))

    # -- in the GUI thread --------------------------------------------------------------------

    def _deliver(self, call: Callable[[], None]) -> None:
        call()

    def _renew(self, generation: int) -> None:
        self._generation = generation

    def _tell(self, job: _Job, step: str, share: float) -> None:
        if job in self._wanted:
            self.progressed.emit(step, share)

    def _refuse(self, job: _Job, failed: Failed) -> None:
        if job in self._wanted:
            self._wanted.discard(job)
            job.failed(failed)

    def _over(self, job: _Job, answer: Any) -> None:
        if job in self._wanted:
            self._wanted.discard(job)
            job.then(answer)
        else:
            job.unwanted(answer)
