"""Results as ROS 2 messages, over Zenoh."""

from dataclasses import replace

import numpy as np
import pytest
from streams import over_zenoh
from wire import STORE

from benchmarks.window.live_soak import free_port
from bubbleviz.api.estimator import PRODUCTS
from bubbleviz.live import (
    DIAGNOSTICS,
    POSE,
    RESULT_TOPICS,
    Counters,
    ResultMessages,
    SessionOptions,
    Status,
    ZenohPublisher,
    open_session,
    status_of,
)
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Pose
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import DepthNoise, SyntheticSource, default_path

MARKER = STORE.types["visualization_msgs/msg/Marker"]


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
    names = {
        "membrane",
        "contact_patch",
        "contact_wrench",
        "contact_wrench_sigma",
        "contact_markers",
    }
    assert found.keys() == {f"/bubbleviz/left/{name}" for name in names}
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
    sigma = found["/bubbleviz/left/contact_wrench_sigma"].wrench
    np.testing.assert_array_equal(
        [sigma.force.x, sigma.force.y, sigma.force.z], estimate.force_sigma_n
    )
    of_torque = np.array([sigma.torque.x, sigma.torque.y, sigma.torque.z])
    np.testing.assert_allclose(of_torque, estimate.torque_sigma_about(np.zeros(3)))
    # about the origin, far from the contact, nearly that of the force's moment
    moments = np.cross(patch.center_of_pressure_m, np.eye(3))  # of a unit force along each axis
    of_force = moments.T @ estimate.wrench_covariance[:3, :3] @ moments
    assert 0.5 < np.linalg.norm(of_torque) / np.sqrt(np.trace(of_force)) < 1.5
    (markers,) = (message.markers for name, message in found.items() if name.endswith("markers"))
    for message in (*markers, *(found[name] for name in found if not name.endswith("markers"))):
        stamp = message.header.stamp
        assert message.header.frame_id == "bubble"
        assert (stamp.sec, stamp.nanosec) == (1_790_000_000, 123_456_789)


def rows_of(cloud):
    """The points of a cloud, read as the fields tell, by name."""
    kinds = {2: "u1", 7: "<f4"}
    layout = {
        "names": [field.name for field in cloud.fields],
        "formats": [kinds[field.datatype] for field in cloud.fields],
        "offsets": [field.offset for field in cloud.fields],
        "itemsize": cloud.point_step,
    }
    rows = np.frombuffer(cloud.data.tobytes(), np.dtype(layout))
    assert (cloud.height, cloud.width, cloud.row_step) == (1, len(rows), cloud.data.size)
    return rows


def test_membrane_has_all_nodes_where_they_are_now(pipeline, pressed):
    found = decoded(ResultMessages(pipeline.mesh).of(pressed))
    cloud, patch = found["/bubble/membrane"], rows_of(found["/bubble/contact_patch"])
    rows, estimate = rows_of(cloud), pressed.estimate
    assert rows.dtype.names == ("x", "y", "z", "pressure", "residual", "in_patch")
    assert np.isnan(rows["residual"]).all() and not cloud.is_dense  # not requested
    nodes = np.column_stack([rows["x"], rows["y"], rows["z"]])
    np.testing.assert_allclose(nodes, pipeline.mesh.deformed(estimate.motion_m), atol=1e-7)
    np.testing.assert_allclose(rows["pressure"], estimate.contact_pressure_pa, rtol=1e-6)
    inside = rows[rows["in_patch"] == 1]
    assert set(rows["in_patch"]) == {0, 1}
    for name in patch.dtype.names:
        np.testing.assert_array_equal(inside[name], patch[name])


def markers_of(pipeline, result, obj=None):
    """Markers after the first one, which deletes those of the message before, by namespace."""
    found = decoded(ResultMessages(pipeline.mesh, obj=obj).of(result))
    first, *others = found["/bubble/contact_markers"].markers
    assert first.action == MARKER.DELETEALL
    assert all(each.action == MARKER.ADD and each.lifetime.nanosec for each in others)
    return {each.ns: each for each in others}


def xyz(points):
    return np.array([[point.x, point.y, point.z] for point in points])


def test_markers_are_outline_and_force(pipeline, pressed):
    found = markers_of(pipeline, pressed)
    assert found.keys() == {"patch", "force"}
    outline, force, patch = found["patch"], found["force"], pressed.patch
    assert (outline.type, force.type) == (MARKER.LINE_LIST, MARKER.ARROW)
    ends = xyz(outline.points)
    nodes = pipeline.mesh.deformed(pressed.estimate.motion_m)[patch.node_mask]
    assert len(ends) % 2 == 0 and len(ends) > 6
    for inner in nodes[:, :2]:  # around each node of the patch the outline turns once
        way = ends[:, :2] - inner
        first, second = (way[start::2] @ [1.0, 1.0j] for start in range(2))
        assert abs(np.angle(second / first)).sum() > 1.9 * np.pi
    start, tip = xyz(force.points)
    np.testing.assert_allclose(tip, patch.center_of_pressure_m)
    np.testing.assert_allclose(tip - start, 0.01 * patch.force_n)  # 1 cm per N


def test_object_is_drawn_at_its_pose_with_few_triangles(pipeline, pressed):
    T = np.eye(4)
    T[:3, 3] = [0.01, -0.02, 0.05]
    posed = replace(pressed, pose=Pose("ok", T))
    for name, few in (("cylinder", True), ("sphere", False)):
        obj = load_object(name)
        shown = markers_of(pipeline, posed, obj)["object"]
        assert shown.type == MARKER.TRIANGLE_LIST
        assert [shown.pose.position.x, shown.pose.position.z] == [0.01, 0.05]
        corners = xyz(shown.points)
        if few:
            np.testing.assert_array_equal(corners, obj.vertices[obj.triangles].reshape(-1, 3))
        assert 1 < len(corners) / 3 <= min(1000, len(obj.triangles))
        size = np.ptp(obj.vertices, axis=0)
        np.testing.assert_allclose(np.ptp(corners, axis=0), size, atol=0.1 * size.max())
        assert "object" not in markers_of(pipeline, replace(pressed, pose=Pose("lost", T)), obj)
    assert "object" not in markers_of(pipeline, posed)


def test_without_contact_the_force_is_zero_and_the_patch_empty(small_sensor, pipeline):
    result = pipeline.process(press(small_sensor)[0], PRODUCTS)
    found = decoded(ResultMessages(pipeline.mesh).of(result))
    assert found["/bubble/contact_patch"].width == 0
    wrench = found["/bubble/contact_wrench"].wrench
    assert [wrench.force.z, wrench.torque.x] == [0.0, 0.0]
    assert markers_of(pipeline, result) == {}
    assert not rows_of(found["/bubble/membrane"])["in_patch"].any()


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


def test_untrusted_estimate_has_no_numbers_and_says_why(pipeline, pressed):
    doubtful = replace(pressed.estimate, status="implausible", reason="another sensor")
    result = replace(pressed, estimate=doubtful)
    messages = ResultMessages(pipeline.mesh)
    found = decoded(messages.of(result))
    assert found.keys() == {"/bubble/membrane", "/bubble/contact_markers"}
    rows = rows_of(found["/bubble/membrane"])
    assert np.isnan(rows["pressure"]).all() and not rows["in_patch"].any()
    np.testing.assert_allclose(rows["z"], pipeline.mesh.nodes[:, 2], atol=1e-7)
    assert not found["/bubble/membrane"].is_dense
    (said,) = markers_of(pipeline, result).values()
    assert (said.type, said.text) == (MARKER.TEXT_VIEW_FACING, "implausible: another sensor")
    assert said.pose.position.z > pipeline.mesh.nodes[:, 2].max()
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
        "stale, no image for 3.0 s": 3,
    }


def test_results_arrive_over_zenoh_only_at_the_endpoint(pipeline, pressed, eventually):
    messages = list(ResultMessages(pipeline.mesh).of(pressed))
    expected = {
        f"3{each.topic}/{each.type.replace('/msg/', '::msg::dds_::')}_/"
        f"{STORE.hash_rihs01(each.type)}": each.payload
        for each in messages
    }
    assert "3/bubble/contact_markers/visualization_msgs::msg::dds_::MarkerArray_/" in {
        key.rsplit("RIHS01", 1)[0] for key in expected
    }
    assert over_zenoh(messages, 3, eventually) == expected


def test_only_subscribed_topics_are_made(pipeline, pressed, eventually):
    """The names are announced all the same, of what the pipeline can give."""
    messages, place = ResultMessages(pipeline.mesh), f"tcp/127.0.0.1:{free_port()}"
    with ZenohPublisher(SessionOptions("out", listen=place)) as out:
        assert list(messages.of(pressed, out.is_subscribed)) == []
        listener = open_session(SessionOptions("in", place))
        try:
            announced = [
                str(reply.ok.key_expr).split("/")[9]
                for reply in listener.liveliness().get("@ros2_lv/**")
            ]
            subscriber = listener.declare_subscriber("0/bubble/membrane/**", lambda _: None)
            eventually(lambda: [m.topic for m in messages.of(pressed, out.is_subscribed)])
            topics = [m.topic for m in messages.of(pressed, out.is_subscribed)]
            subscriber.undeclare()
        finally:
            listener.close()
    assert topics == ["/bubble/membrane"]
    names = [f"%bubble%{name}" for name, each in RESULT_TOPICS.items() if each.product == "patch"]
    assert sorted(announced) == sorted(names)


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


def test_membrane_shows_the_residual_around_each_node(pipeline, pressed):
    """A ripple of the depth image that no contact explains is where it was added."""
    _, column = np.indices(pressed.frame.depth_m.shape)
    ripple = 2e-4 * np.sin(2.0 * np.pi * column / 16.0)
    frame = replace(pressed.frame, depth_m=pressed.frame.depth_m + ripple.astype(np.float32))
    pipeline.restart()
    result = pipeline.process(frame, frozenset({"patch"}))
    assert result.estimate.status == "ok"
    messages = ResultMessages(pipeline.mesh, model=pipeline.model)
    rows = rows_of(decoded(messages.of(result))["/bubble/membrane"])
    camera, x = pipeline.camera, pipeline.mesh.nodes
    places = camera.intrinsics.project((x - camera.center) @ camera.T_B_C[:3, :3])
    expected = 2e-4 * np.sin(2.0 * np.pi * places[:, 0] / 16.0)
    known = np.isfinite(rows["residual"])
    assert np.count_nonzero(known) > 0.7 * len(x)  # the camera does not see the rim
    assert np.corrcoef(rows["residual"][known], expected[known])[0, 1] > 0.7
