"""How much memory a piece of work takes."""

from __future__ import annotations

import gc
import sys
from pathlib import Path


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
