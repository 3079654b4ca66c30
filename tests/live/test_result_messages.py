"""Results as ROS 2 messages, over Zenoh and into a recording; the zero of the gas pressure."""

import time
from dataclasses import replace

import numpy as np
import pytest
from streams import over_zenoh
from wire import CLOUD, STORE, WRENCH

import bubbleviz as bv
from bubbleviz.api.estimator import PRODUCTS
from bubbleviz.api.watching import Watcher
from bubbleviz.errors import InputError
from bubbleviz.live import (
    DIAGNOSTICS,
    POSE,
    Counters,
    LiveSource,
    LiveStream,
    ResultMessages,
    Status,
    status_of,
)
from bubbleviz.pipeline import Pipeline
from bubbleviz.pressure_zero import ZERO_FRAMES, PressureZero
from bubbleviz.recordings import Frame, FrameMessages, RecordingWriter
from bubbleviz.result import Pose
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import DepthNoise, SyntheticSource, default_path


def press(sensor, frames=30):
    poses = default_path(0.05, 0.15, frames)
    return SyntheticSource(
        sensor, load_object("sphere"), poses, DepthNoise(relative=0.001), nodes=600
    )


@pytest.fixture(scope="module")
def pipeline(small_sensor):
    return Pipeline.of(small_sensor)


@pytest.fixture(scope="module")
def pressed(small_sensor, pipeline):
    frame = press(small_sensor)[18]
    result = pipeline.process(replace(frame, stamp_ns=1_790_000_000_123_456_789), PRODUCTS)
    assert result.estimate.status == "ok"
    return result


def decoded(messages):
    return {m.topic: STORE.deserialize_cdr(m.payload, m.type) for m in messages}


def test_messages_have_patch_and_force_of_the_estimate(pipeline, pressed):
    found = decoded(ResultMessages(pipeline.mesh, "/bubbleviz/left").of(pressed))
    assert sorted(found) == ["/bubbleviz/left/contact_patch", "/bubbleviz/left/contact_wrench"]
    cloud, stamped = found["/bubbleviz/left/contact_patch"], found["/bubbleviz/left/contact_wrench"]
    patch, estimate = pressed.patch, pressed.estimate
    assert patch is not None
    assert estimate is not None
    fields = [(field.name, field.offset, field.datatype) for field in cloud.fields]
    assert fields == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("pressure", 12, 7)]  # float32
    assert cloud.point_step == 16 and not cloud.is_bigendian
    rows = cloud.data.view("<f4").reshape(cloud.height * cloud.width, 4)
    inside = patch.node_mask
    assert len(rows) == inside.sum() >= 3
    np.testing.assert_allclose(
        rows[:, :3], pipeline.mesh.deformed(estimate.displacement_m)[inside], atol=1e-7
    )
    np.testing.assert_allclose(rows[:, 3], estimate.contact_pressure_pa[inside], rtol=1e-6)
    force = stamped.wrench.force
    np.testing.assert_array_equal([force.x, force.y, force.z], patch.force_n)
    torque = stamped.wrench.torque
    # The moment of the pressure on the linear membrane, about the origin of B
    mesh = pipeline.mesh
    nodal = -(mesh.areas * estimate.contact_pressure_pa)[:, None] * mesh.normals
    moment = np.cross(mesh.deformed(estimate.displacement_m), nodal).sum(axis=0)
    np.testing.assert_allclose([torque.x, torque.y, torque.z], moment, atol=1e-12)
    for message in found.values():
        stamp = message.header.stamp
        assert (stamp.sec, stamp.nanosec) == (1_790_000_000, 123_456_789)


def test_without_contact_the_force_is_zero_and_the_patch_empty(small_sensor, pipeline):
    result = pipeline.process(press(small_sensor)[0], PRODUCTS)
    found = decoded(ResultMessages(pipeline.mesh).of(result))
    assert found["/bubble/contact_patch"].width == 0
    wrench = found["/bubble/contact_wrench"].wrench
    assert [wrench.force.z, wrench.torque.x] == [0.0, 0.0]


def test_pose_is_published_if_known(pipeline, pressed):
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    T[:3, 3] = [0.01, -0.02, 0.05]
    spread = np.diag([1e-8, 4e-8, 9e-8, 1e-4, 4e-4, 9e-4])
    posed = replace(pressed, pose=Pose("ok", T, center_m=T[:3, 3], covariance=spread))
    found = decoded(ResultMessages(pipeline.mesh).of(posed))
    assert np.allclose(found["/bubble/object_pose"].pose.covariance.reshape(6, 6), spread)
    pose = found["/bubble/object_pose"].pose.pose
    assert [pose.position.x, pose.position.y, pose.position.z] == [0.01, -0.02, 0.05]
    half = np.sqrt(0.5)
    assert abs(pose.orientation.z) == pytest.approx(half)
    assert pose.orientation.w * pose.orientation.z > 0
    for status in ("lost", "no_contact", "few_points", "no_data"):  # `lost` keeps its last place
        gone = replace(pressed, pose=Pose(status, T))
        assert "/bubble/object_pose" not in decoded(ResultMessages(pipeline.mesh).of(gone))
    assert POSE == "geometry_msgs/msg/PoseWithCovarianceStamped"


def test_untrusted_estimate_is_not_published(pipeline, pressed):
    doubtful = replace(pressed.estimate, status="implausible", reason="another sensor")
    result = replace(pressed, estimate=doubtful)
    messages = ResultMessages(pipeline.mesh)
    assert decoded(messages.of(result)) == {}
    counters = Counters()
    said = messages.diagnostics(0, Status("live", 0.01), counters, result)
    assert (
        STORE.deserialize_cdr(said.payload, said.type).status[0].message
        == "implausible: another sensor"
    )


def test_diagnostics_have_state_and_counters(pipeline, pressed):
    messages = ResultMessages(pipeline.mesh)
    counters = Counters(received=7, undecodable=2, problem="/cam: garbage")
    implausible = replace(pressed, estimate=replace(pressed.estimate, status="implausible"))
    levels = {}
    for status, result in (
        (Status("live", 0.01), pressed),
        (Status("live", 0.01), implausible),
        (Status("connecting", None), None),
        (Status("stale", 3.0), pressed),
    ):
        said = messages.diagnostics(5_000_000_000, status, counters, result)
        assert said.type == DIAGNOSTICS
        (entry,) = STORE.deserialize_cdr(said.payload, said.type).status
        levels[entry.message] = entry.level
        values = {pair.key: pair.value for pair in entry.values}
        assert (values["undecodable"], values["problem"]) == ("2", "/cam: garbage")
    assert levels == {
        "ok": 0,
        "implausible": 2,
        "waiting for the first depth image": 1,
        "stale, nothing for 3.0 s": 3,
    }


def test_results_arrive_over_zenoh_only_at_the_endpoint(pipeline, pressed, eventually):
    messages = list(ResultMessages(pipeline.mesh).of(pressed))
    hashes = {kind: STORE.hash_rihs01(kind) for kind in (CLOUD, WRENCH)}
    patch = f"3/bubble/contact_patch/sensor_msgs::msg::dds_::PointCloud2_/{hashes[CLOUD]}"
    wrench = f"3/bubble/contact_wrench/geometry_msgs::msg::dds_::WrenchStamped_/{hashes[WRENCH]}"
    assert over_zenoh(messages, 3, eventually) == {
        patch: messages[0].payload,
        wrench: messages[1].payload,
    }


# -- the zero of the gas pressure ---------------------------------------------------------------


def test_zero_is_learned_in_one_contact_free_run():
    zero = PressureZero(103_900.0)
    frame = Frame(0, 0.0, np.zeros((2, 2)), gas_pressure_pa=102_400.0)
    unknown = zero.applied(frame)
    assert unknown.gas_pressure_pa == 102_400.0
    assert 1.96 * unknown.gas_sigma_pa == pytest.approx(2e3)
    for _ in range(ZERO_FRAMES - 1):
        zero.learn(102_400.0, contact_free=True)
    zero.learn(103_000.0, contact_free=False)  # touched: begin again
    for k in range(ZERO_FRAMES - 1):
        zero.learn(102_400.0 + (k % 3), contact_free=True)
    assert zero.offset_pa is None
    zero.learn(102_400.0, contact_free=True)
    assert zero.offset_pa == pytest.approx(-1499.0)
    assert zero.applied(frame).gas_pressure_pa == pytest.approx(103_899.0)
    assert zero.applied(frame).gas_sigma_pa == 0.0
    zero.learn(999.0, contact_free=True)  # not asked any more
    assert zero.offset_pa == pytest.approx(-1499.0)
    zero.zero_now()
    assert zero.applied(frame).gas_pressure_pa == pytest.approx(103_899.0)  # till the new one
    for _ in range(ZERO_FRAMES):
        zero.learn(102_300.0, contact_free=True)
    assert zero.offset_pa == pytest.approx(-1600.0)
    unmeasured = replace(frame, gas_pressure_pa=None)
    assert zero.applied(unmeasured) is unmeasured


class Weather(LiveSource):
    """The simulated sensor at an atmospheric pressure lower by 800 Pa; sends frames on demand."""

    def __init__(self, simulation):
        super().__init__("weather")
        self.link = "up"
        self.simulation, self.messages, self.sent = simulation, FrameMessages(), 0

    def start(self, deliver):
        self.deliver = deliver

    def send(self):
        now = time.time_ns()
        frame = self.simulation[self.sent % len(self.simulation)]
        for message in self.messages.of(frame, now):
            if message.type.endswith("FluidPressure"):
                content = STORE.deserialize_cdr(message.payload, message.type)
                content.fluid_pressure -= 800.0
                payload = bytes(STORE.serialize_cdr(content, message.type))
                message = message._replace(payload=payload)
            self.deliver(message._replace(arrival_ns=now, sequence=self.sent))
        self.sent += 1


def test_weather_does_not_appear_as_contact(small_sensor):
    """Solved live on another day, with the zero and without."""
    worst = {}
    for zeroed in (False, True):
        source = Weather(press(small_sensor, 90))
        with LiveStream(source, small_sensor) as stream:
            solver = bv.Estimator(small_sensor, zero_gas=zeroed).solver
            watcher, zero = Watcher(stream, solver), solver.zero
            statuses = []
            for _ in range(200):
                source.send()
                result = watcher.step(60.0)
                if zero is None or zero.offset_pa is not None:
                    statuses.append(result.estimate.status)
        worst[zeroed] = {s: statuses.count(s) for s in set(statuses)}
        if zero is not None:
            assert zero.offset_pa == pytest.approx(-800.0, abs=1.0)
    assert worst[True].get("implausible", 0) == 0
    assert worst[True]["ok"] > 10
    assert worst[True]["no_contact"] > 5
    assert worst[False].get("implausible", 0) > 20


def test_recording_is_zeroed_by_default(small_sensor, small_sensor_file, tmp_path):
    """A recording of a day with 800 Pa less: `--no-zero-gas` believes it."""
    path, source = tmp_path / "rec.mcap", press(small_sensor, 200)
    with RecordingWriter(path) as writer:
        for k in (*range(20), *range(80, 90)):
            frame = source[k]
            assert frame.gas_pressure_pa is not None
            writer.write(replace(frame, gas_pressure_pa=frame.gas_pressure_pa - 800.0))
    with pytest.raises(InputError, match="no frame looks like the membrane"):
        bv.estimate(bv.open(path), small_sensor_file, zero_gas=False)
    run = bv.estimate(bv.open(path, "18:"), small_sensor_file, out=tmp_path / "zeroed.npz")
    assert run.facts()["status"] == {"no_contact": 2, "ok": 10}
    assert run.context["gas_zero"] == "gas pressure zero: -800 Pa from 15 contact-free frames"
    assert run.context["gas_zero"] in run.to_text()
    with np.load(tmp_path / "zeroed.npz") as arrays:
        assert float(arrays["gas_pressure_offset_pa"]) == pytest.approx(-800.0, abs=1.0)


def test_message_without_a_zero(small_sensor_file, small_sensor, tmp_path):
    """Without gas pressure there is none; without contact-free frames it is the weather's."""
    source = press(small_sensor, 200)
    for name, frames, measured, says in (
        ("none", range(3), False, None),
        (
            "held",
            range(80, 84),
            True,
            "unknown without contact-free frames, within the weather's ±2 kPa",
        ),
    ):
        path = tmp_path / f"{name}.mcap"
        with RecordingWriter(path) as writer:
            for k in frames:
                frame = source[k]
                writer.write(frame if measured else replace(frame, gas_pressure_pa=None))
        run = bv.estimate(bv.open(path), small_sensor_file, out=tmp_path / f"{name}.npz")
        zero = run.context["gas_zero"]
        assert zero is None if says is None else says in zero
        with np.load(tmp_path / f"{name}.npz") as arrays:
            assert "gas_pressure_offset_pa" not in arrays


@pytest.mark.parametrize(
    ("link", "silent", "state"),
    [
        ("connecting", None, "connecting"),
        ("up", None, "connecting"),
        ("up", 0.3, "live"),
        ("up", 0.9, "stale"),
        ("lost", 0.3, "live"),
        ("lost", 0.9, "reconnecting"),
        ("ended", 0.1, "ended"),
    ],
)
def test_a_source_that_stopped_is_stale_within_a_second(link, silent, state):
    assert status_of(link, silent).state == state


def test_pending_zero_checks_few_frames_during_contact():
    zero, asked = PressureZero(1e5), 0
    for _ in range(60):
        if zero.wants_next():
            asked += 1
            zero.learn(1e5, contact_free=False)
    assert asked == 10
    rested = 0
    while zero.waiting:
        rested += 1
        if zero.wants_next():
            zero.learn(1e5 + 20.0, contact_free=True)
    assert zero.offset_pa == 20.0 and rested < 21
    assert not zero.wants_next()
