"""How fast the window replays: real renders counted, not asserted."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import median

from bubbleviz.sensor import Sensor
from ui.app import screen_for_pictures
from ui.session import WindowSession, window_session

WARM_UP_S = 2.0
BIN_S = 1.0


def replay_fps(
    sensor: Sensor,
    recording: Path | None = None,
    seconds: float = 8.0,
    size: tuple[int, int] = (1280, 800),
) -> dict[str, float]:
    """Replay at recorded speed with membrane and cloud shown, and count what is drawn.

    Parameters
    ----------
    sensor : Sensor
    recording : Path, optional
        None for the synthetic press.
    seconds : float
        How long to count after warming up.
    size : (int, int)
        Window size in pixels.

    Returns
    -------
    dict
        `camera_hz`; `median_fps`, `worst_fps`: VTK renders in a second; `solve_hz`: frames
        solved in a second; `solve_ms`: median time of depth in → products out; `dropped_frames`
        and `shown_frames` while counting; `seconds`; `width`, `height` in pixels.
    """
    with screen_for_pictures(*size), window_session(sensor, recording, None) as session:
        session.window.resize(*size)
        session.window.show()
        session.state.choose(layers=session.state.choices.layers | {"membrane", "cloud"})
        run_for(WARM_UP_S)
        return {**_count(session, seconds), "width": size[0], "height": size[1]}


def _count(session: WindowSession, seconds: float) -> dict[str, float]:
    controller, view = session.controller, session.window.view
    times: list[float] = []
    controller.shown.connect(lambda result: times.append(result.times_ms["total"]))
    fps: list[float] = []
    dropped, start = controller.dropped, time.perf_counter()
    while time.perf_counter() - start < seconds:
        count, began = view.render_count, time.perf_counter()
        run_for(BIN_S)
        fps.append((view.render_count - count) / (time.perf_counter() - began))
    elapsed = time.perf_counter() - start
    return {
        "camera_hz": session.state.facts.rate_hz if session.state.facts else float("nan"),
        "median_fps": median(fps),
        "worst_fps": min(fps),
        "solve_hz": len(times) / elapsed,
        "solve_ms": median(times) if times else float("nan"),
        "shown_frames": len(times),
        "dropped_frames": controller.dropped - dropped,
        "seconds": elapsed,
    }


def run_for(seconds: float) -> None:
    """Run the event loop as the application would, without a pause between events."""
    from PySide6.QtCore import QEventLoop, QTimer

    loop = QEventLoop()
    QTimer.singleShot(round(1e3 * seconds), loop.quit)
    loop.exec()
