"""The programs of examples/, on simulated sources."""

import re
from dataclasses import replace

import figures
import numpy as np
import press_until
import pytest
import ros2_without_ros
from small_press import record, write_press

import bubbleviz as bv
from benchmarks.window.live_soak import free_port
from bubbleviz.errors import StreamStoppedError
from bubbleviz.live import SessionOptions, ZenohPublisher
from bubbleviz.recordings import RecordingWriter

WRENCH = "/bubbleviz/contact_wrench"
DEEPER = (*(0.060,) * 4, 0.048, 0.046, 0.044, 0.043, 0.042, 0.041, *(0.040,) * 20)
"""Held at the end: however late a loaded machine is, the robot stops before the last frame."""


class Recorded:
    """A robot that records its commands."""

    def __init__(self):
        self.told: list[str] = []

    def move(self, velocity_m_per_s, valid_s):
        assert 0.0 < velocity_m_per_s <= 0.01 and valid_s <= 0.1
        self.told.append("move")

    def stop(self):
        self.told.append("stop")


@pytest.fixture(scope="module")
def recording(sensor):
    return write_press(sensor.with_name("deeper.mcap"), sensor, DEEPER)


def test_the_robot_stops_at_the_force_and_before_the_end(recording, sensor):
    every = np.linalg.norm(bv.estimate(bv.open(recording), sensor).force_n, axis=1)
    limit = 0.6 * every.max()
    robot = Recorded()
    with bv.connect(f"replay:{recording}?speed=0.1", sensor) as stream:
        last = press_until.press_until(stream, robot, limit)
    assert last is not None and last.index < len(DEEPER) - 1
    assert last.force_magnitude_n + last.force_magnitude_half_width_n >= limit
    assert robot.told[-1] == "stop" and robot.told.count("stop") == 1


def test_robot_stops_at_an_untrusted_result(sensor, tmp_path):
    press = bv.simulate(sensor, "cylinder", "0.005 0 0.060 0 0 0 1", frames=1)
    dark = replace(press[0], depth_m=np.full_like(press[0].depth_m, np.nan), stamp_ns=0)
    record(tmp_path / "dark.mcap", (replace(dark, index=k, time_s=k / 10.0) for k in range(5)))
    robot = Recorded()
    with bv.connect(f"replay:{tmp_path / 'dark.mcap'}", sensor) as stream:
        last = press_until.press_until(stream, robot, 3.0)
    assert last is not None and last.status == "no_data"
    assert robot.told == ["stop"]


def test_the_robot_is_stopped_when_the_camera_dies(sensor, tmp_path, capsys):
    """It would else press on for as long as nobody looks."""
    press = bv.simulate(sensor, "cylinder", "0.005 0 0.060 0 0 0 1", frames=1)
    noise = np.random.default_rng(0)
    with RecordingWriter(tmp_path / "dies.mcap") as writer:
        for k, time_s in enumerate((*np.arange(0.0, 2.0, 0.05), 30.0)):
            seen = press[0].depth_m + noise.normal(0.0, 1e-5, press[0].depth_m.shape)
            frame = replace(press[0], index=k, time_s=time_s, stamp_ns=0)
            writer.write(replace(frame, depth_m=seen.astype(np.float32)))
    robot = Recorded()
    with (
        bv.connect(f"replay:{tmp_path / 'dies.mcap'}", sensor) as stream,
        pytest.raises(StreamStoppedError, match="no depth image"),
    ):
        press_until.press_until(stream, robot, 3.0)
    assert robot.told[0] == "move"
    assert robot.told[-1] == "stop" and robot.told.count("stop") == 1
    late_ms = re.search(
        r"told to stop (\d+) ms after this image was taken", capsys.readouterr().out
    )
    assert late_ms and int(late_ms[1]) >= 1000  # the time that is waited


def test_the_robot_is_stopped_when_the_camera_repeats_its_image(sensor, tmp_path):
    press = bv.simulate(sensor, "cylinder", "0.005 0 0.060 0 0 0 1", frames=1)
    same = replace(press[0], stamp_ns=0)
    record(tmp_path / "hung.mcap", (replace(same, index=k, time_s=0.05 * k) for k in range(80)))
    robot = Recorded()
    with bv.connect(f"replay:{tmp_path / 'hung.mcap'}", sensor) as stream:
        last = press_until.press_until(stream, robot, 3.0)
        assert not stream.ended
    assert last is not None and last.status == "no_contact"
    assert robot.told[0] == "move" and robot.told[-1] == "stop"


@pytest.mark.long
def test_the_figures_of_the_pages_can_be_made(tmp_path, punyo_press):
    figures.gas_law(tmp_path / "gas.svg")
    figures.real_press(punyo_press, tmp_path / "press.svg")
    assert all(path.stat().st_size > 5_000 for path in tmp_path.iterdir())


class UntilArrived:
    """The publisher, which ends the endless source once a topic has arrived elsewhere."""

    def __init__(self, out, stream, arrived):
        self.out, self.stream, self.arrived = out, stream, arrived

    def is_subscribed(self, topic, kind):
        return self.out.is_subscribed(topic, kind)

    def put(self, message):
        self.out.put(message)
        if WRENCH in self.arrived:
            self.stream.close()


def test_force_is_published_as_a_ros_2_message(recording, sensor):
    """Another session, as `ros2 topic echo` has, gets the wrench."""
    place = f"tcp/127.0.0.1:{free_port()}"
    arrived: list[str] = []
    replay = bv.connect(f"replay:{recording}?speed=0.1&loop=1", sensor)
    with (
        ZenohPublisher(SessionOptions("test", listen=place)) as out,
        bv.connect(f"zenoh:{place}?wrench={WRENCH}", sensor) as listening,
        replay as stream,
    ):
        listening.listen(lambda message: arrived.append(message.topic))
        count = ros2_without_ros.publish_results(stream, UntilArrived(out, stream, arrived))
    assert WRENCH in arrived and count > 0
