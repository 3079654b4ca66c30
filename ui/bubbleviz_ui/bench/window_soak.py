"""The work of `bubbleviz bench live --window`: the soak with the window open."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import quantiles

from bubbleviz.errors import InputError
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.bench.live_soak import (
    Measured,
    SoakReport,
    drain,
    free_port,
    images_sent,
    report_of,
    resident_bytes,
    resized_file,
    start_publisher,
)
from bubbleviz_ui.bench.live_window import live_window, run_of
from bubbleviz_ui.bench.replay_rate import beats, run_for
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.window_session import WindowSession

STEP_S = 1.0  # s between readings


@dataclass(frozen=True)
class WindowSoak:
    """What `bench live --window` measured.

    Attributes
    ----------
    soak : SoakReport
        Its latency is from the stamp to the picture.
    pictures_hz : float
        Pictures VTK drew a second.
    blocked_p99_ms, blocked_ms : float
        Between two beats of the event loop: 99th percentile, and the longest.
    load_average, cores : float, int
        Of the machine over the last minute.
    """

    soak: SoakReport
    pictures_hz: float
    blocked_p99_ms: float
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

    Parameters
    ----------
    sensor_name : str
    seconds, rate_hz : float
    out : Path, optional
        Where the recording stays.
    size : (int, int), optional
        Width and height of the images in place of the sensor's, pixels.
    """
    with tempfile.TemporaryDirectory(prefix="bubbleviz-soak-") as folder:
        path = out or Path(folder) / "soak.mcap"
        if size is not None:
            sensor_name = resized_file(load_sensor(sensor_name), size, Path(folder))
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        source = f"synthetic:?rate={rate_hz:g}&encoding=16UC1"
        publisher = start_publisher(sensor_name, endpoint, source)
        try:
            with live_window(single(f"zenoh:{endpoint}", sensor_name)) as session, beats() as gaps:
                measured, pictures_hz = _soak(session, seconds, path, publisher, gaps)
        finally:
            publisher.kill()
            publisher.communicate()
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
    publisher: subprocess.Popen[str],
    gaps_ms: list[float],
) -> tuple[Measured, float]:
    live, run = session.window.live_controller, run_of(session)
    stream = run.frames[0].stream
    session.wait_for(lambda: len(run.frames[0]) > 0, "the first solved frame")
    live.recording.start(run.session.recorder, path)
    session.wait_for(lambda: live.recording.state() is not None, "the recording")
    session.window.picture_age.begin(10**7)
    skipped, solved = stream.counters().skipped, len(run.frames[0])
    pictures, memory = session.window.view.render_count, list[tuple[float, int]]()
    began = time.monotonic()
    gaps_ms.clear()  # of starting
    while (elapsed := time.monotonic() - began) < seconds:
        run_for(min(STEP_S, seconds - elapsed))
        memory.append((time.monotonic() - began, resident_bytes()))
    pictures_hz = (session.window.view.render_count - pictures) / (time.monotonic() - began)
    ages, solved = session.window.picture_age.ages_s, len(run.frames[0]) - solved
    skipped = stream.counters().skipped - skipped
    sent = images_sent(publisher)
    drain(stream)
    state = live.recording.state()
    if state is None:
        raise InputError("bench live: the recording ended early")
    live.close()
    return Measured(solved, skipped, ages, memory, state.status, sent), pictures_hz
