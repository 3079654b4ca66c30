"""Time from process start, and from a seek, to the picture."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
from PySide6.QtCore import QEventLoop

from benchmarks.window.bench_window import SIZE, bench_window
from benchmarks.window.first_picture import FIRST
from bubbleviz.errors import InputError
from bubbleviz.sensor import Sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.engine.worker import Failed
from bubbleviz_ui.window_session import WindowSession

CHILD = (
    "from benchmarks.window.first_picture import first_picture; "
    "first_picture({recording!r}, {sensor!r})"
)


def start_times(recording: Path, sensor: str | None, runs: int = 5) -> dict[str, float]:
    """Time from the start of a process to the first picture of a recording, s.

    Each run is a separate process that acts like `bubbleviz open`. The first one warms the disk
    cache and is reported as `cold_s`; `cpu_s` is the mean processor time of a run with its screen,
    which depends least on other load. InputError: the recording cannot be opened.
    """
    times = []
    for _ in range(runs + 1):
        with screen_for_pictures(*SIZE):  # one per run: it ends with its last client
            times.append(_start(CHILD.format(recording=str(recording), sensor=sensor)))
    counted = times[1:]
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "fastest_s": min(counted),
        "median_s": median(counted),
        "longest_s": max(counted),
        "cold_s": times[0],
        "cpu_s": (spent.ru_utime + spent.ru_stime) / (runs + 1),
        "runs": runs,
        "load_average": os.getloadavg()[0],
    }


def _start(code: str) -> float:
    # A user's second start has compiled modules, which some environments forbid to write
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    command, start = [sys.executable, "-c", code], time.time()
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=120
    )
    said = [line for line in done.stdout.splitlines() if line.startswith(FIRST)]
    if not said:
        raise InputError(
            f"no picture appeared: {(done.stderr.splitlines() or ['nothing said'])[-1]}"
        )
    return float(said[0].removeprefix(FIRST)) - start


def seek_times(sensor: Sensor, recording: Path, seeks: int = 60, seed: int = 0) -> dict[str, float]:
    """Time from a seek anywhere to the picture of that frame, ms; errors as of `start_times`."""
    with bench_window(sensor, recording, 0) as session:
        session.wait_until_drawn()
        frames = session.state.facts.frames if session.state.facts else 0
        order = np.random.default_rng(seed).integers(0, frames, seeks)
        took = [_seek(session, int(frame)) for frame in order if int(frame) != session.state.frame]
    return {
        "median_ms": median(took),
        "p95_ms": float(np.quantile(took, 0.95)),
        "longest_ms": max(took),
        "seeks": len(took),
        "frames": frames,
        "load_average": os.getloadavg()[0],
    }


def _seek(session: WindowSession, frame: int) -> float:
    """Seek and wait, in the application's event loop, until the frame is drawn, ms."""
    controller, view, loop = session.controller, session.window.view, QEventLoop()

    def note() -> None:
        if controller.result.frame.index == frame:
            drawn.append(time.perf_counter())
            loop.quit()

    def give_up(failed: Failed) -> None:
        problems.append(failed.message)
        loop.quit()

    drawn, problems = list[float](), list[str]()
    seen, failed = view.rendered.connect(note), controller.failed.connect(give_up)
    start = time.perf_counter()
    session.state.seek(frame)
    loop.exec()
    view.rendered.disconnect(seen)
    controller.failed.disconnect(failed)
    session.raise_if_interrupted()
    if problems:
        raise InputError(problems[0])
    return 1e3 * (drawn[0] - start)
