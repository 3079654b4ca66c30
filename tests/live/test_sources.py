"""Simulated, replayed and RealSense sources."""

import threading
import time

import numpy as np
import pytest
from realsense_file import record_realsense
from streams import messages_in, played, recorded
from wire import IMAGE, INFO, NOW, PERIOD, PRESSURE, SECOND, STORE, depth, gas

from bubbleviz.api.watching import Watcher
from bubbleviz.errors import InputError
from bubbleviz.live import (
    LiveSession,
    LiveStream,
    Replay,
    SensorPlace,
    SessionPreset,
    SyntheticLive,
    load_session,
    open_stream,
)
from bubbleviz.live.realsense import set_exposure
from bubbleviz.recordings import Message, Recording
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import SyntheticSource, finger_pose, grip_poses, oversized_nut


@pytest.fixture
def recording(tmp_path):
    """Ten images and gas pressures, one of each every 33 ms."""
    stamps = [NOW + k * PERIOD for k in range(10)]
    messages = [m for k, s in enumerate(stamps) for m in (gas(s, 1e5 + k), depth(s, k))]
    return recorded(tmp_path / "rec.mcap", messages)


def test_simulation_streams_with_current_time_stamps(small_sensor):
    with open_stream("synthetic:?rate=100&frames=4&noise=0", small_sensor) as stream:
        first = stream.take(60.0)
        assert abs(time.time_ns() - first.stamp_ns) < 30 * SECOND
        assert first.gas_pressure_pa is not None
        assert first.intrinsics is not None
        later = [stream.take(10.0) for _ in range(12)]
    assert all(frame is not None for frame in later)
    assert stream.status().state == "ended"
    assert stream.take(1.0) is None or stream.take(1.0) is None
    assert stream.counters.bad_stamps == 0


def test_every_loop_repeats_the_frames_with_new_stamps(small_sensor, eventually):
    seen: list[Message] = []
    stream = open_stream("synthetic:?rate=100&frames=3&encoding=16UC1", small_sensor)
    stream.listen(seen.append)
    with stream:
        eventually(lambda: len([m for m in seen if m.type == IMAGE]) >= 9)
    images = [m for m in seen if m.type == IMAGE][:9]
    shown = [STORE.deserialize_cdr(m.payload, IMAGE) for m in images]
    stamps = [SECOND * m.header.stamp.sec + m.header.stamp.nanosec for m in shown]
    np.testing.assert_allclose(np.diff(stamps), SECOND // 100, atol=1)
    assert [m.stamp_ns for m in images] == stamps
    for k in range(3):
        assert shown[k].data.tobytes() == shown[k + 3].data.tobytes() == shown[k + 6].data.tobytes()
    assert shown[0].data.tobytes() != shown[1].data.tobytes()
    beside = {m.stamp_ns for m in seen if m.type in (INFO, PRESSURE)}
    assert beside >= set(stamps)


def test_simulation_on_the_fly_equals_the_precomputed_one(small_sensor):
    depths = []
    for ahead in (0, 1):
        source = f"synthetic:sphere?rate=200&frames=3&seed=4&ahead={ahead}&prefix=/left"
        with open_stream(source, small_sensor) as stream:
            frame = stream.take(60.0)
            while frame is not None and frame.index % 3 != 1:
                frame = stream.take(60.0)
            depths.append(frame.depth_m)
            assert all(topic.name.startswith("/left/") for topic in stream.source.topics)
    np.testing.assert_array_equal(depths[0], depths[1])


class SlowSimulation:
    """Forty times one frame; `before` is called before each."""

    times_s = np.arange(40) / 10.0

    def __init__(self, sensor, before):
        with open_stream("synthetic:?frames=2", sensor) as stream:
            self.frame = stream.take(5.0)
        self.before = before

    def __len__(self):
        return len(self.times_s)

    def __getitem__(self, index):
        self.before(index)
        return self.frame

    def close(self):
        pass


def test_a_simulation_begins_before_all_frames_are_simulated(small_sensor):
    """The later ones are due in four seconds, and none of them is ready until then."""
    held = threading.Event()
    slow = SlowSimulation(small_sensor, lambda index: index < 30 or held.wait())
    with LiveStream(SyntheticLive("slow", lambda: slow, 10.0), small_sensor) as stream:
        first = stream.take(5.0)
        held.set()
    assert first is not None


def test_a_simulation_slower_than_its_rate_begins_late_though_frames_are_seen_in_bursts(
    small_sensor,
):
    """What counts is how long frames take, not when the source's thread gets to see them."""
    made, ten = list[int](), threading.Event()

    def before(index):
        threading.Event().wait(0.01)  # a frame takes ten times its share of the time
        made.append(index)
        if index == 10:
            ten.set()

    class Busy(SyntheticLive):
        """Its thread gets to see the first ten frames at once."""

        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            if name == "preparing" and " of " in value:
                ten.wait()

    slow = SlowSimulation(small_sensor, before)
    with LiveStream(Busy("slow", lambda: slow, 1000.0), small_sensor) as stream:
        assert stream.take(5.0) is not None
        assert len(made) > 30


def test_only_the_newest_frame_is_delivered_and_skipped_ones_counted(small_sensor, eventually):
    seen: list[Message] = []
    stream = open_stream("synthetic:?rate=200&frames=3", small_sensor)
    stream.listen(seen.append)
    with stream:
        assert stream.take(60.0) is not None
        eventually(lambda: stream.counters.frames > 30)
        frame = stream.take(10.0)
        assert frame.index >= 30
        assert stream.counters.skipped >= 25
    images = [message.sequence for message in seen if message.type == IMAGE]
    assert images == list(range(len(images)))  # who listens misses none


def test_every_frame_is_counted_as_solved_or_skipped(small_sensor, eventually):
    """Also the first one, from which the solver was built while newer ones arrived."""
    stream = open_stream("synthetic:?rate=200&frames=3", small_sensor)
    with stream:
        watcher = Watcher.on(stream, small_sensor)
        eventually(lambda: stream.counters.frames > 5)
        solved = sum(watcher.step(1.0) is not None for _ in range(3))
    left = stream.take() is not None  # of the last frame nobody has asked
    counters = stream.counters
    assert counters.frames == solved + counters.skipped + left


def test_a_waiting_listener_does_not_block_readers(small_sensor):
    """A recorder that waits for its disk must not block the window, which reads its status."""
    waiting, go_on = threading.Event(), threading.Event()

    def wait(message):
        waiting.set()
        go_on.wait()

    stream = open_stream("synthetic:?rate=200&frames=2", small_sensor)
    stream.listen(wait)
    with stream:
        assert waiting.wait(60.0)
        assert stream.counters.received == 0
        assert stream.status().state == "connecting"
        assert len(stream.source.topics) == 3
        assert stream.take() is None
        go_on.set()
        assert stream.take(30.0) is not None


def test_a_replay_gives_the_recorded_bytes_at_the_recorded_pace(recording, eventually):
    got: list[Message] = []
    source = Replay(recording, speed=2.0)
    source.start(got.append)
    eventually(lambda: source.link == "ended")
    source.stop()
    assert [m.payload for m in got if m.type == IMAGE] == [
        depth(NOW + k * PERIOD, k).payload for k in range(10)
    ]
    took = got[-1].arrival_ns - got[0].arrival_ns  # half the time, less what starting took
    assert took >= 0.5 * 9 * PERIOD / 2.0
    assert source.problem == ""


def test_replay_is_held_while_the_solver_is_built(recording, eventually):
    got: list[Message] = []
    arrived = threading.Event()

    def deliver(message):
        got.append(message)
        arrived.set()

    source = Replay(recording, speed=0.2)  # six images a second
    source.start(deliver)
    assert arrived.wait(60.0)
    with source.held():
        before = len(got)
        arrived.clear()
        while arrived.wait(0.5):  # one message may be on its way
            arrived.clear()
        assert len(got) <= before + 1
    eventually(lambda: source.link == "ended")
    source.stop()
    assert sum(m.type == IMAGE for m in got) == 10


def test_looped_replay_continues(recording, small_sensor):
    stream = open_stream(f"replay:{recording}?loop=1&speed=20", small_sensor, any_size=True)
    with stream:
        for _ in range(1000):
            frame = stream.take(30.0)
            if frame.index > 35:
                break
        counters = stream.counters
    assert (counters.bad_stamps, counters.out_of_order, counters.duplicate) == (0, 0, 0)


# -- two fingers --------------------------------------------------------------------------------


def test_nut_has_the_same_world_pose_for_both_fingers():
    """T_W_O through either finger is the same while they are closed, by the preset's own poses."""
    session = load_session("dual_nut")
    left, right = session.sensors
    height = load_sensor(left.sensor).membrane.height_m
    assert height is not None
    poses = {
        place.name: place.T_W_B @ grip_poses(place.name, height, 60) for place in (left, right)
    }
    closed = slice(20, 44)
    np.testing.assert_allclose(poses["left"][closed], poses["right"][closed], atol=1e-8)
    assert np.ptp(poses["left"][closed][:, 0, 1]) > 0.1  # it turns
    for place in (left, right):
        np.testing.assert_allclose(place.T_W_B, finger_pose(place.name, height), atol=1e-9)


def test_each_finger_presses_its_side_of_the_nut(small_sensor):
    nut = oversized_nut()
    assert np.ptp(nut.vertices[:, 1]) == pytest.approx(0.048)
    forces = []
    for side in ("left", "right"):
        poses = grip_poses(side, 0.05, 40)
        source = SyntheticSource(small_sensor, nut, poses, nodes=500)
        open_, closed = source.truth(0), source.truth(13)
        assert np.linalg.norm(open_.force_n) == 0.0
        T_W_B = finger_pose(side, 0.05)
        forces.append(T_W_B[:3, :3] @ closed.force_n)
    assert np.linalg.norm(forces[0]) > 1.0
    # what one finger feels the other feels the other way round
    np.testing.assert_allclose(forces[0], -forces[1], atol=0.05 * np.linalg.norm(forces[0]))


def sent_pressures(path, topic):
    """Gas pressures of a recording as the `mcap` library and rosbags read them."""
    found = messages_in(path, topic)
    return [STORE.deserialize_cdr(m.data, PRESSURE).fluid_pressure for _, _, m in found]


def test_two_sensors_are_recorded_into_one_file_with_separate_topics(
    small_sensor_file, tmp_path, eventually
):
    places = [
        SensorPlace(
            name=side,
            sensor=str(small_sensor_file),
            source=f"synthetic:nut-{side}?prefix=/{side}&frames=6&rate=60&seed={seed}",
        )
        for seed, side in enumerate(("left", "right"))
    ]
    path = tmp_path / "both.mcap"
    with LiveSession(SessionPreset(title="both", sensors=tuple(places))) as session:
        session.recorder.start(path)
        before = {s.place.name: s.stream.counters.frames for s in session.sensors}
        for each in session.sensors:
            frame = each.stream.take(60.0)
            assert frame is not None
        eventually(lambda: all(s.stream.counters.frames > 12 for s in session.sensors))
    sent = {s.place.name: s.stream.counters for s in session.sensors}
    pressures = {}
    for side, counters in sent.items():
        assert (counters.undecodable, counters.duplicate) == (0, 0)
        with Recording(path, depth_topic=f"/{side}/depth/image_raw") as recording:
            # the recording may have started within a frame
            assert len(recording) >= counters.frames - before[side] - 1
            assert recording.intrinsics is not None
            pressures[side] = recording.gas_pressures_pa()
        np.testing.assert_array_equal(pressures[side], sent_pressures(path, f"/{side}/pressure"))
    assert not np.array_equal(pressures["left"], pressures["right"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("schema_version = 2", "schema_version"),
        ('colour = "red"', "colour"),
        ("quaternion_xyzw = [1.0, 1.0, 0.0, 0.0]", "unit length"),
        ("speed = 1", "speed"),
        ("= =", "the TOML file cannot be read"),
    ],
)
def test_session_files_are_refused_by_key(tmp_path, change, says):
    path = tmp_path / "session.toml"
    lines = ["schema_version = 1", 'title = "x"', "[[sensors]]", 'name = "a"', 'sensor = "s"']
    text = "\n".join([*lines, 'source = "synthetic:"', change])
    if change.startswith("schema"):
        text = text.replace("schema_version = 1\n", change + "\n", 1).removesuffix(change)
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        load_session(path)
    with pytest.raises(InputError, match="dual_nut"):
        load_session("nothing_of_this_name")


# -- RealSense ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def realsense_file(tmp_path_factory):
    return record_realsense(tmp_path_factory.mktemp("realsense") / "camera.db3", 12)


def test_exposure_of_a_realsense_camera_is_set_within_its_range():
    """On the SDK's software device, whose exposure is 0.1 to 33 ms."""
    rs = pytest.importorskip("pyrealsense2")
    device = rs.software_device()
    sensor, bare = device.add_sensor("Stereo Module"), device.add_sensor("other")
    for option, high in ((rs.option.exposure, 33_000.0), (rs.option.enable_auto_exposure, 1.0)):
        limits = rs.option_range()
        limits.min, limits.max, limits.step = 0.0 if high == 1.0 else 100.0, high, 1.0
        limits.default = high
        sensor.add_option(option, limits)
    set_exposure(rs, sensor, 8.5)
    assert sensor.get_option(rs.option.exposure) == 8_500.0
    assert sensor.get_option(rs.option.enable_auto_exposure) == 0.0
    for each, exposure_ms, problem in (
        (sensor, 40.0, "0.1 to 33 ms"),
        (bare, 8.5, "cannot be set"),
    ):
        with pytest.raises(InputError, match=problem):
            set_exposure(rs, each, exposure_ms)


def test_exposure_of_a_realsense_file_is_refused(realsense_file, small_sensor):
    with pytest.raises(InputError, match="exposure of a file cannot be changed"):
        open_stream(f"realsense:{realsense_file}?exposure=8", small_sensor)


def test_realsense_sdk_file_is_replayed_and_looped(realsense_file, small_sensor):
    messages: list[Message] = []
    stream = open_stream(f"realsense:{realsense_file}", small_sensor)
    stream.listen(messages.append)
    frame = played(stream)
    assert frame.depth_m.shape == (48, 64)
    assert frame.depth_m[5, 5] == pytest.approx(0.1011, abs=1e-6)
    assert np.isnan(frame.depth_m[0, 0])
    assert frame.intrinsics.distortion_model == "inverse_brown_conrady"
    assert frame.intrinsics.distortion == pytest.approx((0.1, 0, 0, 0, 0.01))
    images = [message for message in messages if message.type == IMAGE]
    assert [message.sequence for message in images] == list(range(12))
    np.testing.assert_allclose(np.diff([m.stamp_ns for m in images]), SECOND / 30, atol=2000)
    assert stream.status().state == "ended"
    assert stream.counters.missed == 0
    # looped it goes on
    with open_stream(f"realsense:{realsense_file}?loop=1", small_sensor) as stream:
        frame = stream.take(30.0)
        while frame is not None and frame.index < 14:
            frame = stream.take(30.0)
        assert frame is not None
        assert stream.counters.bad_stamps == 0


def test_missing_camera_gives_one_line(small_sensor):
    rs = pytest.importorskip("pyrealsense2")
    if len(rs.context().query_devices()):
        pytest.skip("a RealSense camera is plugged in")
    with pytest.raises(InputError, match="no RealSense camera on this computer"):
        open_stream("realsense:", small_sensor)


def test_streams_end_when_their_source_fails(small_sensor, eventually):
    """The object of the simulation cuts the rim: the stream reports it and ends."""

    def make():
        poses = np.tile(np.eye(4), (2, 1, 1))
        poses[:, 0, 3] = 0.07
        return SyntheticSource(small_sensor, oversized_nut(), poses)

    stream = LiveStream(SyntheticLive("broken", make, 30.0), small_sensor)
    with stream:
        eventually(lambda: stream.status().state == "ended")
        assert "rim" in stream.source.problem
