"""Processor time of the threads of this process and of other processes (Linux)."""

from __future__ import annotations

import os
import threading
from collections import defaultdict
from pathlib import Path

TICKS_HZ = float(os.sysconf("SC_CLK_TCK"))


def thread_seconds() -> dict[str, float]:
    """Processor time of each thread so far, s, by its name; threads of one name together.

    Threads not started by Python have the names given by libraries, without their numbers.
    """
    names = {each.native_id: each.name for each in threading.enumerate()}
    used: dict[str, float] = defaultdict(float)
    for task in Path("/proc/self/task").iterdir():
        try:
            stat = (task / "stat").read_text(encoding="utf-8")
        except OSError:  # it has ended meanwhile
            continue
        given = stat[stat.index("(") + 1 : stat.rindex(")")].rstrip("0123456789-_:")
        used[names.get(int(task.name), given)] += _seconds(stat)
    return used


def process_seconds(number: int) -> float:
    """Processor time of a process so far, s."""
    return _seconds(Path(f"/proc/{number}/stat").read_text(encoding="utf-8"))


def _seconds(stat: str) -> float:
    user, system = stat[stat.rindex(")") + 2 :].split()[11:13]
    return (int(user) + int(system)) / TICKS_HZ
