"""Jobs in processes of this computer.

Not by a pool of the standard library, for the reasons that `worker_process` gives.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import ExitStack
from multiprocessing.connection import wait
from typing import Any

from bubbleviz.batch.batch_job import Job, run_job
from bubbleviz.batch.summary_row import Row
from bubbleviz.processes.worker_process import Outcome, WorkerProcess


def run_in_processes(jobs: Sequence[Job], processes: int) -> Generator[Row]:
    """Rows of jobs as they end, in any order; closing the iterator ends the processes.

    A process that dies costs its own job only.
    """
    left = list(reversed(jobs))
    busy: dict[Any, tuple[WorkerProcess, Job]] = {}
    with ExitStack() as stack:
        idle = [stack.enter_context(WorkerProcess()) for _ in range(min(processes, len(left)))]
        while left or busy:
            while left and idle:
                worker, job = idle.pop(), left.pop()
                worker.send(run_job, job)
                busy[worker.pipe] = worker, job
            for pipe in wait(list(busy)):
                worker, job = busy.pop(pipe)
                yield _row(job, worker.outcome())
                idle.append(worker)


def _row(job: Job, outcome: Outcome) -> Row:
    if outcome.kind == "returned":
        row: Row = outcome.value
        return row
    return Row(job.name, "failed", error=f"{job.recording}: {outcome.detail}")
