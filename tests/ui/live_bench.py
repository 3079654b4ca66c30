"""A window with live sources for tests: small sensors, and a robot in a process of its own."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fakes import DentSource, record, small_sensor
from mcap.reader import make_reader
from window_driver import PATIENCE_MS, Driver

from bubbleviz.live import SensorPlace, SessionPreset
from bubbleviz.sensor import sensor_to_toml
from bubbleviz.simulation import resized
from bubbleviz.zeros import ZERO_FRAMES
from bubbleviz_ui.live.connection import single
from tests.small_press import changed

WIDTH, HEIGHT = 64, 48
"""Of the robot's images, pixels."""
IMAGE, STRING = "sensor_msgs/msg/Image", "std_msgs/msg/String"


def robot_sensor(**pneumatics):
    """The small dome seen by a camera of the robot's image size."""
    return changed(resized(small_sensor("robot dome"), WIDTH, HEIGHT), pneumatics=pneumatics)


def sensor_file(folder, name="robot_dome", **pneumatics):
    path = folder / f"{name}.toml"
    path.write_text(sensor_to_toml(robot_sensor(**pneumatics)), encoding="utf-8")
    return str(path)


def sensor_pair_preset(folder, source="synthetic:?frames=6"):
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
    def live_controller(self):
        return self.window.live_controller

    @property
    def second(self):
        """The sensor that the panels do not show; None if there is a single one."""
        controller = self.window.controller
        return next((each for each in controller.clients if each is not controller.client), None)

    @property
    def run(self):
        assert self.live_controller.run is not None
        return self.live_controller.run

    @property
    def shown_frame(self):
        """Number of the frame that is shown; -1 before the first."""
        return self.result.frame.index

    def connect(self, preset):
        """Connect and wait for pictures of frames that come live."""
        with self.bot.waitSignal(self.window.controller.opened, timeout=PATIENCE_MS):
            self.live_controller.connect_to(preset)
        self.wait(lambda: self.shown_frame >= 3)

    def wait_for_frames(self, frames=3):
        """Wait until so many more frames were shown."""
        before = self.shown_frame if self.state.facts.grows else 0
        self.wait(lambda: self.state.facts.grows)
        self.wait(lambda: self.shown_frame >= before + frames)

    def wait_for_messages(self, count, sensor=0):
        """Wait until so many more messages of a sensor have arrived."""
        stream = self.run.session.sensors[sensor].stream
        enough = stream.counters.received + count
        self.wait(lambda: stream.counters.received >= enough)

    def learn_zero(self, reading_pa=None, shift_pa=0.0):
        """Have the zero of the gas pressure learned from readings at rest; returns it."""
        zero = self.run.session.sensors[0].zero
        zero.zero_now()
        for _ in range(ZERO_FRAMES):
            zero.learn(reading_pa or zero.reference_pa + shift_pa, contact_free=True)
        return zero

    def record(self):
        """Press the record button and wait until it writes."""
        self.state.change(record_folder=str(self.folder))
        self.window.live.record.click()
        self.wait(lambda: self.status().messages > 5)

    def status(self):
        status = self.live_controller.recording.status()
        assert status is not None
        return status

    def stop(self):
        """Press it again and wait until the file is whole."""
        path = Path(self.status().path)
        self.window.live.record.click()
        self.wait(lambda: f"Recorded {path}" in self.window.notice.label.toolTip())
        return path


SYNTHETIC = "synthetic:?frames=6"


def connected_bench(open_bench):
    """A window on one simulated sensor."""
    live = open_bench()
    live.connect(single(SYNTHETIC, sensor_file(live.folder)))
    return live


def record_dents(path, presses=5):
    """Record a few presses; the last frame is one."""
    dents = list(DentSource(robot_sensor())) * presses
    return record(path, (replace(f, index=k, time_s=k / 30.0) for k, f in enumerate(dents)))


def messages_by_type(path):
    """Messages of a recording by type, read by the `mcap` library itself."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_summary() is not None  # there is a footer: the file is whole
        for schema, _, message in reader.iter_messages(log_time_order=False):
            found.setdefault(schema.name, []).append(message)
    return found
