"""Work off the GUI thread: in order, with progress, a way out, and its end told in the GUI."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

from PySide6.QtCore import QCoreApplication, QObject, Qt, Signal

from bubbleviz.errors import InputError, SolveError
from bubbleviz.progress import Cancelled, Progress

Job = Callable[[Progress], Any]
"""Runs in the thread; stops when its progress raises `Cancelled`."""

TELL_EVERY_S = 0.05
"""Nobody reads faster."""
PATIENCE_S = 10.0
"""How long a window that closes waits for a step that cannot be interrupted; chosen."""


@dataclass(frozen=True)
class Done:
    """A job that is over: with an answer, or with a message and the details of a bug."""

    answer: Any = None
    message: str = ""
    details: str = ""


Then = Callable[[Done], None]


def _ignore(_: Any) -> None:
    """Nothing is to be done."""


@dataclass(frozen=True, eq=False)
class _Waiting:
    job: Job
    then: Then
    unwanted: Callable[[Any], None]


class Jobs(QObject):
    """A thread of its own, made with the first job, that does one job after the other."""

    progressed = Signal(str, float)  # Step in plain words, and the share of it that is done
    _told = Signal(object, str, float)
    _over = Signal(object, object)

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name = name
        self._wanted: set[_Waiting] = set()
        self._executor: ThreadPoolExecutor | None = None
        self._told.connect(self._on_told, Qt.ConnectionType.QueuedConnection)
        self._over.connect(self._on_over, Qt.ConnectionType.QueuedConnection)

    @property
    def busy(self) -> bool:
        """A job runs or waits whose end is still wanted."""
        return bool(self._wanted)

    def run(
        self, job: Job, then: Then = _ignore, unwanted: Callable[[Any], None] = _ignore
    ) -> None:
        """Do a job after all that wait already.

        `then`: Gets its `Done` in the GUI thread, unless it is cancelled.
        `unwanted`: Lets go of the answer of a job that was cancelled too late; None where it
        failed.
        """
        waiting = _Waiting(job, then, unwanted)
        self._wanted.add(waiting)
        if self._executor is None:
            self._executor = ThreadPoolExecutor(1, self._name)
        self._executor.submit(self._serve, waiting)

    def replace(self, job: Job, then: Then = _ignore) -> None:
        """Do a job in place of all that run or wait."""
        self.cancel()
        self.run(job, then)

    def cancel(self) -> None:
        """Stop all jobs; nothing more is heard of them."""
        self._wanted.clear()

    def close(self, timeout_s: float = PATIENCE_S) -> None:
        """Wait until all that is wanted is done, and end the thread.

        A job that takes longer goes on, and the process waits for it before it ends: SciPy's
        factorisations of a thread that is still there would change the exit code (scipy#25404).
        """
        if self._executor is not None:
            done, _ = wait([self._executor.submit(lambda: None)], timeout_s)
            self._executor.shutdown(wait=bool(done))
            self._executor = None
            if not done:  # or the thread would be the last to hold this object, and delete it there
                self.setParent(QCoreApplication.instance())

    def _serve(self, waiting: _Waiting) -> None:
        if waiting in self._wanted:
            done = self._done(waiting)
            if done is not None and waiting in self._wanted:
                self._over.emit(waiting, done)
            elif done is not None:
                waiting.unwanted(done.answer)

    def _done(self, waiting: _Waiting) -> Done | None:
        told_s = 0.0

        def progress(step: str, done: float) -> None:
            nonlocal told_s
            if waiting not in self._wanted:
                raise Cancelled
            now = time.monotonic()
            if now - told_s >= TELL_EVERY_S:
                told_s = now
                self._told.emit(waiting, step, done)

        try:
            return Done(waiting.job(progress))
        except Cancelled:
            return None
        except (InputError, SolveError, OSError) as error:
            return Done(message=str(error))
        except Exception as error:
            message = f"{type(error).__name__}: {error}"[:300]
            return Done(message=message, details=traceback.format_exc())

    def _on_told(self, waiting: _Waiting, step: str, share: float) -> None:
        if waiting in self._wanted:
            self.progressed.emit(step, share)

    def _on_over(self, waiting: _Waiting, done: Done) -> None:
        if waiting in self._wanted:
            self._wanted.discard(waiting)
            waiting.then(done)
        else:
            waiting.unwanted(done.answer)
