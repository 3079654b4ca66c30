"""Soak test of `live_soak` with the window open."""

from __future__ import annotations

import json
import os
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import quantiles

from benchmarks.window.bench_window import live_window, recorded_run
from benchmarks.window.live_soak import (
    Measured,
    Publisher,
    SoakReport,
    drain,
    report_of,
    resized_file,
)
from benchmarks.window.process_usage import resident_bytes
from benchmarks.window.replay_rate import beats, run_for
from bubbleviz.api.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.window_session import WindowSession

STEP_S = 1.0  # s between readings


@dataclass(frozen=True)
class WindowSoak(Summary):
    """Results of `live --window`; latency is from the stamp to the picture."""

    soak: SoakReport
    pictures_hz: float
    blocked_p99_ms: float  # between two beats of the event loop
    blocked_ms: float
    load_average: float
    cores: int

    def to_json(self) -> str:
        """JSON object of all numbers."""
        own = {name: value for name, value in asdict(self).items() if name != "soak"}
        return json.dumps({**asdict(self.soak), **own}, indent=2, allow_nan=False)

    def to_text(self) -> str:
        """A few lines for people, with units."""
        return (
            f"{self.soak.to_text()}\nwindow    {self.pictures_hz:.1f} pictures/s; blocked "
            f"{self.blocked_p99_ms:.0f} ms p99, {self.blocked_ms:.0f} ms at most; load "
            f"{self.load_average:.1f} on {self.cores} cores"
        )


def window_soak(
    sensor_name: str,
    seconds: float,
    rate_hz: float = 60.0,
    out: Path | None = None,
    size: tuple[int, int] | None = None,
) -> WindowSoak:
    """Stream over Zenoh into the window for some time, recording everything.

    The size (width, height), pixels, replaces that of the sensor's images.
    """
    with tempfile.TemporaryDirectory(prefix="bubbleviz-soak-") as folder:
        path = out or Path(folder) / "soak.mcap"
        if size is not None:
            sensor_name = resized_file(load_sensor(sensor_name), size, Path(folder))
        with (
            Publisher(sensor_name, f"synthetic:?rate={rate_hz:g}&encoding=16UC1") as publisher,
            live_window(single(publisher.uri, sensor_name)) as session,
            beats() as gaps,
        ):
            measured, pictures_hz = _soak(session, seconds, path, publisher, gaps)
        return WindowSoak(
            report_of(measured, path, seconds, rate_hz),
            pictures_hz,
            quantiles(gaps, n=100)[-1],
            max(gaps),
            os.getloadavg()[0],
            os.cpu_count() or 1,
        )


def _soak(
    session: WindowSession,
    seconds: float,
    path: Path,
    publisher: Publisher,
    gaps_ms: list[float],
) -> tuple[Measured, float]:
    live, run = session.window.live_controller, recorded_run(session, path)
    stream = run.frames[0].stream
    session.wait_for(lambda: len(run.frames[0]) > 0, "the first solved frame")
    session.window.display_latency.begin(10**7)
    skipped, solved = stream.counters.skipped, len(run.frames[0])
    pictures, memory = session.window.view.render_count, list[tuple[float, int]]()
    began = time.monotonic()
    gaps_ms.clear()  # of starting
    while (elapsed := time.monotonic() - began) < seconds:
        run_for(min(STEP_S, seconds - elapsed))
        memory.append((time.monotonic() - began, resident_bytes()))
    pictures_hz = (session.window.view.render_count - pictures) / (time.monotonic() - began)
    ages, solved = session.window.display_latency.ages_s, len(run.frames[0]) - solved
    skipped = stream.counters.skipped - skipped
    sent = publisher.images_sent()
    drain(stream)
    state = live.recording.state()
    if state is None:
        raise InputError("the recording ended early")
    live.close()
    return Measured(solved, skipped, ages, memory, state.status, sent), pictures_hz
