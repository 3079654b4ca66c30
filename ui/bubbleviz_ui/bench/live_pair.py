"""The work of `bubbleviz bench pair`: two cameras over Zenoh into one window."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from bubbleviz.errors import InputError
from bubbleviz.live.session_preset import SensorPlace, SessionPreset
from bubbleviz.sensor import Sensor, load_sensor, sensor_to_toml
from bubbleviz_ui.bench.live_soak import free_port, start_publisher
from bubbleviz_ui.bench.live_window import live_window, run_of
from bubbleviz_ui.bench.replay_rate import run_for
from bubbleviz_ui.window_session import WindowSession


@dataclass(frozen=True)
class PairReport:
    """What `bench pair` measured.

    Attributes
    ----------
    seconds, rate_hz : float
    width, height : int
        Of both cameras, pixels.
    received_hz, solved_hz : (float, float)
        Images that arrived, and frames solved a second, of the chosen sensor and of the other.
    pictures_hz : float
    latency_median_s, latency_p95_s : float
        Stamp to picture, of the chosen sensor.
    load_average, cores : float, int
    """

    seconds: float
    rate_hz: float
    width: int
    height: int
    received_hz: tuple[float, float]
    solved_hz: tuple[float, float]
    pictures_hz: float
    latency_median_s: float
    latency_p95_s: float
    load_average: float
    cores: int

    def to_json(self) -> str:
        """JSON object with the attributes as keys."""
        return json.dumps(asdict(self), indent=2, allow_nan=False)

    def to_text(self) -> str:
        """A few lines for people, with units."""
        received, solved = self.received_hz, self.solved_hz
        return "\n".join(
            [
                f"stream    2 × {self.width}×{self.height} at {self.rate_hz:g} Hz for "
                f"{self.seconds:.0f} s; arrived {received[0]:.1f} and {received[1]:.1f} Hz",
                f"solved    {solved[0]:.1f} and {solved[1]:.1f} Hz",
                f"window    {self.pictures_hz:.1f} pictures/s; latency "
                f"{1e3 * self.latency_median_s:.0f} ms median, {1e3 * self.latency_p95_s:.0f} ms "
                "p95",
                f"machine   load {self.load_average:.1f} on {self.cores} cores",
            ]
        )


def pair_bench(
    preset: SessionPreset, seconds: float, rate_hz: float = 30.0, size: tuple[int, int] = (640, 480)
) -> PairReport:
    """Two simulated cameras, each a process of its own, over Zenoh into one window.

    Parameters
    ----------
    preset : SessionPreset
        Of two synthetic sensors.
    seconds, rate_hz : float
    size : (int, int)
        Width and height of both images, pixels.
    """
    publishers: list[subprocess.Popen[str]] = []
    with tempfile.TemporaryDirectory(prefix="bubbleviz-pair-") as folder:
        try:
            places = tuple(
                _published(place, rate_hz, size, Path(folder), publishers)
                for place in preset.sensors
            )
            with live_window(preset.model_copy(update={"sensors": places})) as session:
                return _count_pair(session, seconds, rate_hz, size)
        finally:
            for publisher in publishers:
                publisher.kill()
                publisher.communicate()


def _published(
    place: SensorPlace,
    rate_hz: float,
    size: tuple[int, int],
    folder: Path,
    publishers: list[subprocess.Popen[str]],
) -> SensorPlace:
    """Have a process stream a synthetic sensor of another image size; the place to see it from."""
    sensor = folder / f"{place.name}.toml"
    sensor.write_text(sensor_to_toml(resized(load_sensor(place.sensor), size)), encoding="utf-8")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    source = f"{place.source}&rate={rate_hz:g}&encoding=16UC1&frames=90"
    publishers.append(start_publisher(str(sensor), endpoint, source))
    return place.model_copy(update={"sensor": str(sensor), "source": f"zenoh:{endpoint}"})


def resized(sensor: Sensor, size: tuple[int, int]) -> Sensor:
    """The same sensor and field of view with other pixels."""
    camera = sensor.camera
    x, y = size[0] / camera.width, size[1] / camera.height
    update = {
        "width": size[0],
        "height": size[1],
        "fx": x * camera.fx,
        "fy": y * camera.fy,
        "cx": x * (camera.cx + 0.5) - 0.5,
        "cy": y * (camera.cy + 0.5) - 0.5,
    }
    return sensor.model_copy(update={"camera": camera.model_copy(update=update)})


def _count_pair(
    session: WindowSession, seconds: float, rate_hz: float, size: tuple[int, int]
) -> PairReport:
    run, view = run_of(session), session.window.view
    run_for(3.0)
    session.window.picture_age.begin(10**6)
    solved, pictures = [len(frames) for frames in run.frames], view.render_count
    received = [frames.stream.counters().frames for frames in run.frames]
    began = time.monotonic()
    run_for(seconds)
    elapsed, report = time.monotonic() - began, session.window.picture_age.report()
    if report is None:
        raise InputError("bench pair: no picture was drawn")

    def rates(before: list[int], now: list[int]) -> tuple[float, float]:
        first, second = ((b - a) / elapsed for a, b in zip(before, now, strict=True))
        return first, second

    return PairReport(
        seconds=elapsed,
        rate_hz=rate_hz,
        width=size[0],
        height=size[1],
        received_hz=rates(received, [f.stream.counters().frames for f in run.frames]),
        solved_hz=rates(solved, [len(f) for f in run.frames]),
        pictures_hz=(view.render_count - pictures) / elapsed,
        latency_median_s=report.median_s,
        latency_p95_s=report.p95_s,
        load_average=os.getloadavg()[0],
        cores=os.cpu_count() or 1,
    )
