"""Main loop of a worker process; sets the number of threads before NumPy is imported."""

from __future__ import annotations

import os
import resource
import threading
import time
import traceback
from multiprocessing.connection import Connection
from typing import Any

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def serve(
    pipe: Connection,  # gives (function, args, keep), takes (kind, value, detail) of an `Outcome`
    parent: int,  # process id; this process ends with it
    memory_limit_bytes: int | None,
) -> None:
    """Run the calls received through a pipe and send their outcomes, until it is closed."""
    os.environ.update(dict.fromkeys(_THREADS, "1"), TQDM_DISABLE="1")
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    from tqdm import tqdm  # reads the environment when it is imported

    tqdm.set_lock(threading.RLock())  # the default is a semaphore that outlives a killed process
    if memory_limit_bytes is not None:
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (memory_limit_bytes, hard))
    kept: tuple[Any, ...] = ()
    while True:
        try:
            function, args, keep = pipe.recv()  # imports the function's module, and BLAS
        except EOFError:
            return
        try:
            value = function(*kept, *args)
            if keep:
                kept, value = (value,), None
            answer = "returned", value, ""
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{last.filename.rsplit('/', 1)[-1]}:{last.lineno}"
            answer = "raised", None, f"{type(error).__name__} at {where}: {error}"
        pipe.send(answer)


def _end_with(parent: int) -> None:
    """End this process soon after its parent, even if the parent was killed."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os._exit(1)
