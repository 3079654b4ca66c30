"""A thread for long jobs, one at a time, with progress and cancel."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any

from PySide6.QtCore import QObject, Qt, Signal

from bubbleviz.errors import InputError, SolveError
from bubbleviz.progress import Cancelled, Progress

Job = Callable[[Progress], Any]
"""Runs in the thread; stops when its progress raises `Cancelled`."""

TELL_EVERY_S = 0.05
"""Nobody reads faster."""


@dataclass(frozen=True)
class Done:
    """A job that is over: with an answer, or with a message and its details."""

    number: int
    answer: Any = None
    message: str = ""
    details: str = ""


class Runner(QObject):
    """Runs jobs in a thread of its own; a newer job stops the one before it.

    Parameters
    ----------
    at_end : callable
        What the thread does last.

    Attributes
    ----------
    progressed : Signal
        Step in plain words, and the share of it that is done.
    done : Signal
        A `Done`, never one that was cancelled or overtaken.
    """

    progressed = Signal(str, float)
    done = Signal(object)
    _told = Signal(int, str, float)
    _over = Signal(object)

    def __init__(self, at_end: Callable[[], object] = lambda: None) -> None:
        super().__init__()
        self._at_end = at_end
        self._number = 0
        self._waiting: tuple[int, Job] | None = None
        self._changed = Condition()
        self._thread: Thread | None = None
        self._closed = False
        self._told.connect(self._on_told, Qt.ConnectionType.QueuedConnection)
        self._over.connect(self._on_over, Qt.ConnectionType.QueuedConnection)
        self.busy = False

    def start(self, job: Job) -> int:
        """Run a job as soon as the present one has stopped; returns its number."""
        with self._changed:
            self._number += 1
            self._waiting = (self._number, job)
            self._changed.notify()
        self.busy = True
        if self._thread is None:
            self._thread = Thread(target=self._run, name="calibration", daemon=True)
            self._thread.start()
        return self._number

    def cancel(self) -> None:
        """Stop the job; nothing more is heard of it."""
        with self._changed:
            self._number += 1
            self._waiting = None
        self.busy = False

    def close(self, timeout_s: float = 10.0) -> None:
        """Stop the job and the thread."""
        self.cancel()
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(timeout_s)
            self._thread = None

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting is not None)
                if self._closed or self._waiting is None:
                    break
                number, job = self._waiting
                self._waiting = None
            self._serve(number, job)
        self._at_end()

    def _serve(self, number: int, job: Job) -> None:
        try:
            done = Done(number, job(self._progress(number)))
        except Cancelled:
            return
        except (InputError, SolveError) as error:
            done = Done(number, message=str(error))
        except Exception as error:
            done = Done(number, message=f"{type(error).__name__}: {error}"[:300],
                        details=traceback.format_exc())  # fmt: skip
        if not self._closed:
            self._over.emit(done)

    def _progress(self, number: int) -> Progress:
        told = 0.0

        def progress(step: str, done: float) -> None:
            nonlocal told
            if number != self._number:
                raise Cancelled
            now = time.monotonic()
            if now - told >= TELL_EVERY_S:
                told = now
                self._told.emit(number, step, done)

        return progress

    def _on_told(self, number: int, step: str, done: float) -> None:
        if number == self._number:
            self.progressed.emit(step, done)

    def _on_over(self, done: Done) -> None:
        if done.number == self._number:
            self.busy = False
            self.done.emit(done)
