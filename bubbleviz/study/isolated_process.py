"""Calls in a separate process, which may hang, crash or exhaust its memory limit."""

from __future__ import annotations

import multiprocessing
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Literal

Kind = Literal["returned", "raised", "hung", "died"]
MEMORY_LIMIT_BYTES = 8 * 2**30  # of a case; chosen: what a small computer has


@dataclass(frozen=True)
class Outcome:
    """What became of a call.

    Attributes
    ----------
    kind : {"returned", "raised", "hung", "died"}
    value : object
        What it returned.
    detail : str
        Type and message of the exception, with the line it came from, or how the process ended.
    ms : float
        Wall time.
    """

    kind: Kind
    value: Any
    detail: str
    ms: float


class Worker:
    """One process that makes calls, one after another; replaced when it hangs or dies.

    Use as a context manager. Functions and arguments must be importable there (`spawn`).
    """

    def __init__(self) -> None:
        self._process: Any = None
        self._pipe: Any = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def call(self, function: Callable[..., Any], *args: Any, limit_s: float) -> Outcome:
        """Call a function; give up after `limit_s`."""
        self._start()
        start = time.perf_counter()
        self._pipe.send((function, args))
        kind: Kind
        try:
            answered = self._pipe.poll(limit_s)
            kind, value, detail = self._pipe.recv() if answered else ("hung", None, "")
        except (EOFError, OSError):
            self._process.join(1.0)
            kind, value = "died", None
            detail = f"the process ended with code {self._process.exitcode}"
        elapsed = 1e3 * (time.perf_counter() - start)
        if kind == "hung":
            detail = f"no answer within {limit_s:.0f} s"
        if kind in ("hung", "died"):
            self.stop()
        return Outcome(kind, value, detail, elapsed)

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._pipe.close()
            self._process.kill()
            self._process.join()
        self._process = None

    def _start(self) -> None:
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
            self._process.start()
            theirs.close()
            self._pipe.send((time.time, ()))  # not to count the start of Python
            self._pipe.recv()


def _serve(pipe: Connection) -> None:
    _limit_memory()
    while True:
        try:
            function, args = pipe.recv()
        except EOFError:
            return
        try:
            answer = ("returned", function(*args), "")
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{last.filename.rsplit('/', 1)[-1]}:{last.lineno}"
            answer = ("raised", None, f"{type(error).__name__} at {where}: {error}")
        pipe.send(answer)


def _limit_memory() -> None:
    try:
        import resource  # not on Windows
    except ImportError:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_LIMIT_BYTES, hard))
