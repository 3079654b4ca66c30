"""Replay rate of the window, by counted renders."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median, quantiles

from PySide6.QtCore import QEventLoop, Qt, QTimer

from benchmarks.window.bench_window import SIZE, bench_window
from bubbleviz.sensor import Sensor
from bubbleviz_ui.window_session import WindowSession

WARM_UP_S = 2.0  # s that are not counted
WINDOW_S = 1.0  # s over which the lowest rate is taken
BEAT_MS = 2  # between beats that show a blocked event loop
TOO_LONG_MS = 50.0  # a noticeable delay


def replay_fps(
    sensor: Sensor, recording: Path | None = None, seconds: float = 8.0
) -> dict[str, float]:
    """Replay at recorded speed with membrane and cloud shown, and count the drawn frames.

    Returns
    -------
    dict
        `camera_hz`; `median_fps`, `p5_fps`: VTK renders in the second before each render;
        `solve_hz`: frames solved and shown in a second; `solve_ms`: median time of depth in →
        products out; `draw_ms`: mean time of the GUI thread for a picture; `blocked_*`: times
        between two beats of a watchdog in the GUI thread; `shown_frames`, `dropped_frames`.
    """
    with bench_window(sensor, recording) as session:
        session.state.change(layers=session.state.settings.layers | {"membrane", "cloud"})
        run_for(WARM_UP_S)
        measured = _count(session, seconds)
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    width, height = SIZE
    return {**measured, "load_average": load, "cores": cores, "width": width, "height": height}


def _count(session: WindowSession, seconds: float) -> dict[str, float]:
    controller, view = session.controller, session.window.view
    solves: list[float] = []
    renders: list[float] = []
    controller.shown.connect(lambda result: solves.append(result.times_ms["total"]))
    view.rendered.connect(lambda: renders.append(time.perf_counter()))
    dropped, busy, start = controller.dropped, view.busy_s, time.perf_counter()
    with beats() as gaps_ms:
        run_for(seconds)
    elapsed = time.perf_counter() - start
    fps = [
        float(sum(now - WINDOW_S < then <= now for then in renders))
        for now in renders
        if now - start >= WINDOW_S
    ]
    return {
        "camera_hz": session.state.facts.rate_hz if session.state.facts else float("nan"),
        "median_fps": median(fps) if fps else len(renders) / elapsed,
        "p5_fps": quantiles(fps, n=20)[0] if len(fps) > 1 else len(renders) / elapsed,
        "solve_hz": len(solves) / elapsed,
        "solve_ms": median(solves) if solves else float("nan"),
        "draw_ms": 1e3 * (view.busy_s - busy) / max(len(renders), 1),
        "blocked_ms": max(gaps_ms, default=float("nan")),
        "blocked_p99_ms": quantiles(gaps_ms, n=100)[-1] if len(gaps_ms) > 1 else float("nan"),
        "blocked_over_50_ms": sum(gap > TOO_LONG_MS for gap in gaps_ms),
        "shown_frames": len(solves),
        "dropped_frames": controller.dropped - dropped,
        "seconds": elapsed,
    }


@contextmanager
def beats() -> Iterator[list[float]]:
    """Times between two beats of a timer in this thread, ms: its blocked times."""
    gaps_ms: list[float] = []
    last = time.perf_counter()

    def beat() -> None:
        nonlocal last
        now = time.perf_counter()
        gaps_ms.append(1e3 * (now - last))
        last = now

    timer = QTimer()
    timer.setTimerType(Qt.TimerType.PreciseTimer)
    timer.timeout.connect(beat)
    timer.start(BEAT_MS)
    yield gaps_ms
    timer.stop()


def run_for(seconds: float) -> None:
    """Run the event loop as the application would, without a pause between events."""
    loop = QEventLoop()
    QTimer.singleShot(round(1e3 * seconds), loop.quit)
    loop.exec()
