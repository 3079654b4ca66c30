"""Jobs in processes of this computer, one BLAS thread each.

A pool of the standard library breaks as a whole when one of its processes dies, and its processes
outlive a parent that was killed; these do neither.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import wait

from bubbleviz.batch.batch_job import Job
from bubbleviz.batch.job_process import serve
from bubbleviz.batch.summary_row import Row


def run_in_processes(jobs: Sequence[Job], processes: int) -> Generator[Row]:
    """Rows of jobs as they end, in any order; closing the iterator ends the processes.

    A process that dies costs its own job only.
    """
    left = list(reversed(jobs))
    busy: list[_Worker] = []
    try:
        while left and len(busy) < processes:
            busy.append(_Worker())
            busy[-1].give(left.pop())
        while busy:
            ready = wait([worker.pipe for worker in busy])
            for worker in [each for each in busy if each.pipe in ready]:
                yield worker.row()
                if left and not worker.died:
                    worker.give(left.pop())
                    continue
                busy.remove(worker)
                worker.end()
                if left:
                    busy.append(_Worker())
                    busy[-1].give(left.pop())
    finally:
        for worker in busy:
            worker.end()


class _Worker:
    """A process that runs jobs one after another."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.died = False
        self._job: Job | None = None
        self._process = context.Process(target=serve, args=(theirs, os.getpid()), daemon=True)
        with _interrupts_for_the_parent():
            self._process.start()
        theirs.close()

    def give(self, job: Job) -> None:
        """Send the next job; `row` tells where that failed."""
        self._job = job
        with suppress(OSError):
            self.pipe.send(job)

    def row(self) -> Row:
        """Row of the job; waits for it."""
        assert self._job is not None
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            self.died = True
            self._process.join()
            how = f"its process ended with code {self._process.exitcode}"
            return Row(self._job.name, "failed", error=f"{self._job.recording}: {how}")

    def end(self) -> None:
        """End the process, whatever it does."""
        self.pipe.close()
        self._process.kill()
        self._process.join()


@contextmanager
def _interrupts_for_the_parent() -> Iterator[None]:
    """Processes started here never see ^C, which a terminal sends to all of them.

    They inherit what is blocked; here it arrives when the block ends. Python before 3.12 unblocks
    it when it starts its resource tracker, with the first process: so that is started before.
    """
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
