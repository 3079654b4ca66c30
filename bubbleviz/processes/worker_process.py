"""A separate process for calls that may hang, crash or exhaust its memory.

Not a `ProcessPoolExecutor`, which fails as a whole when one of its processes dies, cannot cancel a
running job, and leaves its processes alive when their parent is killed; a pool for each process
would take more code than this. The process has one BLAS thread.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from bubbleviz.processes.worker_server import serve

MEMORY_LIMIT_BYTES = 8 * 2**30
"""For calls that may allocate too much; chosen: the memory of a small computer."""

Kind = Literal["returned", "raised", "hung", "died"]


@dataclass(frozen=True)
class Outcome:
    kind: Kind
    value: Any  # return value
    detail: str  # exception with message and line of code, or how the process ended
    ms: float  # wall time


class WorkerProcess:
    """One process that runs calls one after another; replaced when it hangs or dies.

    Use as a context manager. The process can unpickle functions and arguments (`spawn`).
    """

    def __init__(self, memory_limit_bytes: int | None = None) -> None:
        self._memory_limit = memory_limit_bytes
        self._process: Any = None
        self._sent_s = 0.0
        self.pipe: Connection[Any, Any]

    def __enter__(self) -> WorkerProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def call(self, function: Callable[..., Any], *args: Any, limit_s: float) -> Outcome:
        """Call a function; give up after `limit_s`, without the start of Python."""
        if self._process is None:
            self.send(os.getpid)
            self.outcome()
        self.send(function, *args)
        return self.outcome(limit_s)

    @property
    def pid(self) -> int | None:
        """Process id; None while there is no process."""
        process = self._process
        return None if process is None else int(process.pid)

    def send(self, function: Callable[..., Any], *args: Any, keep: bool = False) -> None:
        """Start a call; `pipe` is ready when it has ended, and `outcome` returns the result.

        With `keep` the return value stays in the process, as first argument of later calls.
        """
        if self._process is None:
            self._start()
        self._sent_s = time.perf_counter()
        with suppress(OSError):  # the process died: `outcome` reports it
            self.pipe.send((function, args, keep))

    def outcome(self, limit_s: float | None = None) -> Outcome:
        """Wait for the end of the call, at most `limit_s`."""
        kind: Kind
        try:
            answered = limit_s is None or self.pipe.poll(limit_s)
            kind, value, detail = self.pipe.recv() if answered else ("hung", None, "")
        except (EOFError, OSError):
            self._process.join()
            kind, value = "died", None
            code = self._process.exitcode
            signalled = f" (killed by signal {-code})" if code < 0 else ""
            detail = f"the process ended with code {code}{signalled}"
        elapsed = 1e3 * (time.perf_counter() - self._sent_s)
        if kind == "hung":
            detail = f"no answer within {limit_s:.0f} s"
        if kind in ("hung", "died"):
            self.stop()
        return Outcome(kind, value, detail, elapsed)

    def kill(self) -> None:
        """Kill the process from another thread; `outcome` then returns "died"."""
        process = self._process
        if process is not None:
            process.kill()

    def stop(self) -> None:
        """Kill the process and wait for its end."""
        if self._process is not None:
            self.pipe.close()
            self._process.kill()
            self._process.join()
        self._process = None

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        args = theirs, os.getpid(), self._memory_limit
        process = context.Process(target=serve, args=args, daemon=True)
        with _block_interrupts():
            process.start()
        self._process = process  # after the start: only a running process can be killed
        theirs.close()


@contextmanager
def _block_interrupts() -> Iterator[None]:
    """Processes started in this block ignore ^C, which a terminal sends to all processes.

    They inherit the blocked signal; this process receives it after the block. Python before 3.12
    unblocks it when it starts its resource tracker, so that is started first.
    """
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class PeakMemory:
    """Increase of the peak resident memory of this process within a block.

    Where the system cannot reset the peak (not Linux), it is the increase over the earlier peak.
    """

    increase_bytes = 0

    def __enter__(self) -> PeakMemory:
        gc.collect()  # garbage freed within the block would hide part of its peak
        clear = Path("/proc/self/clear_refs")
        try:
            clear.write_text("5", encoding="ascii")
        except OSError:
            self._start = _peak_bytes()
        else:
            self._start = _status_bytes("VmRSS:")
        return self

    def __exit__(self, *_: object) -> None:
        self.increase_bytes = max(0, _peak_bytes() - self._start)


def _peak_bytes() -> int:
    try:
        return _status_bytes("VmHWM:")
    except OSError:
        import resource  # not on Windows

        unit = 1 if sys.platform == "darwin" else 1024
        return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _status_bytes(key: str) -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(key))
