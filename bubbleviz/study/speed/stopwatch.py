"""Time spent in the parts of an estimator, measured where they run."""

from __future__ import annotations

import gc
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

STAGES = {
    "measure": "observe",
    "weigh": "observe",
    "linearise": "linearise",
    "relinearise": "linearise",
    "assemble": "assemble",
    "select": "solve",
    "refine": "solve",
    "solve": "solve",
}
"""Stage by the name of the method that does it, on whichever part of the estimator has it."""


class Stopwatch:
    """Adds up the time of an estimator's stages.

    Parameters
    ----------
    estimator : Estimator
        Its parts' methods are wrapped, on these instances alone.

    Attributes
    ----------
    ms : dict
        Time by stage since the last `lap`.
    """

    def __init__(self, estimator: Any) -> None:
        self.ms: defaultdict[str, float] = defaultdict(float)
        self._inside = False
        for part in vars(estimator).values():
            for method, stage in STAGES.items():
                if callable(getattr(type(part), method, None)):
                    setattr(part, method, self._timed(getattr(part, method), stage))

    def lap(self) -> dict[str, float]:
        """Times since the last lap."""
        times, self.ms = dict(self.ms), defaultdict(float)
        return times

    def _timed(self, call: Any, stage: str) -> Any:
        def timed(*args: Any, **named: Any) -> Any:
            if self._inside:  # one stage may call another: the outer one counts
                return call(*args, **named)
            self._inside = True
            start = time.perf_counter()
            try:
                return call(*args, **named)
            finally:
                self.ms[stage] += 1e3 * (time.perf_counter() - start)
                self._inside = False

        return timed


class PeakMemory:
    """Peak of this process's resident memory from the start of the block, less what it had then.

    Where the system cannot reset the peak (not Linux), only what exceeds the peak so far counts.

    Attributes
    ----------
    increase_bytes : int
    """

    increase_bytes = 0

    def __enter__(self) -> PeakMemory:
        gc.collect()  # garbage that goes within the block would be taken off its peak
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
