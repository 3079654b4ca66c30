"""A window with live sources for tests: small sensors, and a robot in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fakes import DentSource, record, small_sensor
from mcap.reader import make_reader
from window_driver import Driver

from bubbleviz.calibration import ENOUGH
from bubbleviz.live import SensorPlace, SessionPreset
from bubbleviz.sensor import Sensor, sensor_to_toml
from bubbleviz_ui.live.connection import LiveRun, single
from bubbleviz_ui.live.live_controller import LiveController

ROBOT = Path(__file__).parents[1] / "live" / "robot.py"
WIDTH, HEIGHT = 64, 48
"""Of the robot's images, pixels."""
IMAGE, STRING = "sensor_msgs/msg/Image", "std_msgs/msg/String"


def robot_sensor(**pneumatics: float) -> Sensor:
    """The small dome seen by a camera of the robot's image size."""
    sensor = small_sensor("robot dome")
    size = {"width": WIDTH, "height": HEIGHT, "fx": 36.8, "fy": 30.4, "cx": 31.5, "cy": 23.5}
    camera = sensor.camera.model_copy(update=size)
    air = sensor.pneumatics.model_copy(update=pneumatics)
    return sensor.model_copy(update={"camera": camera, "pneumatics": air})


def sensor_file(folder: Path, name: str = "robot_dome", **pneumatics: float) -> str:
    path = folder / f"{name}.toml"
    path.write_text(sensor_to_toml(robot_sensor(**pneumatics)), encoding="utf-8")
    return str(path)


@contextmanager
def robot(port: int, first: int = 0, *mode: str) -> Iterator[subprocess.Popen[str]]:
    """Publishes images as a ROS 2 node with rmw_zenoh, until it is killed."""
    command = [sys.executable, str(ROBOT), str(port), "rmw", str(first), *mode]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def two(folder: Path, source: str = "synthetic:?frames=6") -> SessionPreset:
    """Two small sensors that face each other along the world's y."""
    name, half = sensor_file(folder), 0.5**0.5
    return SessionPreset(
        title="Two",
        sensors=(
            SensorPlace(
                name="left", sensor=name, source=f"{source}&prefix=/left&seed=1",
                position_m=(0.0, -0.06, 0.0), quaternion_xyzw=(-half, 0.0, 0.0, half),
            ),
            SensorPlace(
                name="right", sensor=name, source=f"{source}&prefix=/right&seed=2",
                position_m=(0.0, 0.06, 0.0), quaternion_xyzw=(half, 0.0, 0.0, half),
                colour="#d08a4f",
            ),
        ),
    )  # fmt: skip


@dataclass
class Bench(Driver):
    """A window and its live sources."""

    folder: Path

    @property
    def live_controller(self) -> LiveController:
        return self.window.live_controller

    @property
    def run(self) -> LiveRun:
        assert self.live_controller.run is not None
        return self.live_controller.run

    @property
    def shown(self) -> int:
        """Number of the frame that is shown; -1 before the first."""
        result = self.window.controller.result
        return -1 if result is None else result.frame.index

    def connect(self, preset: SessionPreset) -> None:
        """Connect and wait for pictures of frames that come live."""
        self.live_controller.connect_to(preset)
        self.follow()

    def follow(self, frames: int = 3) -> None:
        """Wait until so many more frames were shown."""
        facts = self.state.facts
        before = self.shown if facts is not None and facts.grows else 0
        self.wait(lambda: self.state.facts is not None and self.state.facts.grows)
        self.wait(lambda: self.shown >= before + frames)

    def messages_come(self, count: int, sensor: int = 0) -> None:
        """Wait until so many more messages of a sensor have arrived."""
        counters = self.run.session.sensors[sensor].stream.counters
        enough = counters().received + count
        self.wait(lambda: counters().received >= enough)

    def learn_zero(self, reading_pa: float | None = None, shift_pa: float = 0.0) -> Any:
        """Have the zero of the gas pressure learned from readings at rest; returns it."""
        zero = self.run.session.sensors[0].zero
        zero.zero_now()
        for _ in range(ENOUGH):
            zero.learn(reading_pa or zero.reference_pa + shift_pa, contact_free=True)
        return zero

    def record(self) -> None:
        """Press the record button and wait until it writes."""
        self.live_controller.choose_folder(self.folder)
        self.window.live.record.button.click()
        self.wait(lambda: self.status().messages > 5)

    def status(self) -> Any:
        state = self.live_controller.recording.state()
        assert state is not None
        return state.status

    def stop(self) -> Path:
        """Press it again and wait until the file is whole."""
        path = Path(self.status().path)
        self.window.live.record.button.click()
        self.wait(lambda: "Recorded" in self.window.notice.label.text())
        return path


Open = Callable[[], Bench]
SYNTHETIC = "synthetic:?frames=6"


def connected(open_bench: Open) -> Bench:
    """A window on one simulated sensor."""
    live = open_bench()
    live.connect(single(SYNTHETIC, sensor_file(live.folder)))
    return live


def record_dents(path: Path, presses: int = 5) -> Path:
    """Record a few presses; the last frame is one."""
    dents = list(DentSource(robot_sensor())) * presses
    return record(path, (replace(f, index=k, time_s=k / 30.0) for k, f in enumerate(dents)))


def contents(path: Path) -> dict[str, list[Any]]:
    """Messages of a recording by type, read by the `mcap` library itself."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_summary() is not None  # there is a footer: the file is whole
        for schema, _, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            found.setdefault(schema.name, []).append(message)
    return found
