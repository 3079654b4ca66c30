"""A process that runs jobs; it chooses the number of threads before it imports numbers."""

from __future__ import annotations

import os
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def serve(pipe: Connection, parent: int) -> None:
    """Run the jobs that come through a pipe and answer with their rows, until it is closed.

    Parameters
    ----------
    pipe : Connection
    parent : int
        Process without which this one ends.
    """
    os.environ.update(dict.fromkeys(_THREADS, "1"), TQDM_DISABLE="1")
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    from tqdm import tqdm  # reads the environment when it is imported, as BLAS does

    from bubbleviz.batch.batch_job import run_job  # imports numpy, and BLAS with it

    tqdm.set_lock(threading.RLock())  # its own is a semaphore that outlives a process killed
    while True:
        try:
            job: Any = pipe.recv()
        except EOFError:
            return
        pipe.send(run_job(job))


def _end_with(parent: int) -> None:
    """End this process soon after its parent, even one that was killed."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)
