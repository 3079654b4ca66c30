"""A watch that was recorded, read by a program of others: rosbags."""

from collections import defaultdict

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from wire import STORE

import bubbleviz as bv
from bubbleviz.recordings import Frame, FrameMessages, StaticPoses

TOPICS = {
    "/bubble/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/bubble/depth/image_raw": "sensor_msgs/msg/Image",
    "/bubble/pressure": "sensor_msgs/msg/FluidPressure",
    "/bubbleviz/contact_patch": "sensor_msgs/msg/PointCloud2",
    "/bubbleviz/contact_markers": "visualization_msgs/msg/MarkerArray",
    "/bubbleviz/contact_wrench": "geometry_msgs/msg/WrenchStamped",
    "/bubbleviz/contact_wrench_sigma": "geometry_msgs/msg/WrenchStamped",
    "/bubbleviz/membrane": "sensor_msgs/msg/PointCloud2",
    "/bubbleviz/object_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


@pytest.fixture(scope="module")
def watched(tmp_path_factory, small_sensor):
    folder = tmp_path_factory.mktemp("watch")
    source = "synthetic:cylinder?frames=20&rate=10&ahead=1"
    for duration_s in (2.5, 10.0, 60.0):  # on a busy machine few frames are solved in a second
        out = folder / f"{duration_s:g}.mcap"
        done = bv.watch(source, small_sensor, out=out, object="cylinder", duration_s=duration_s)
        if done.status.get("ok", 0) > 3:
            return out
    raise AssertionError(done)


def test_rosbags_reads_every_topic_and_all_frames_of_reference_are_connected(watched, small_sensor):
    named, poses, drawn = defaultdict(set), StaticPoses(), set()
    with AnyReader([watched]) as bag:
        assert {name: topic.msgtype for name, topic in bag.topics.items()} == TOPICS
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)  # by the schema in the file
            if connection.topic == "/tf_static":
                poses = poses.after(message)
                continue
            stamped = getattr(message, "markers", [message])
            drawn |= {each.ns for each in getattr(message, "markers", [])}
            for frame_id in {each.header.frame_id for each in stamped} - {""}:  # diagnostics
                named[frame_id].add(connection.topic)
    assert drawn == {"", "patch", "force", "object"}
    assert named.keys() == {"bubble", "bubble_depth_optical_frame"}
    T_B_C = poses.pose("bubble_depth_optical_frame", "bubble")
    np.testing.assert_allclose(T_B_C, small_sensor.camera.T_B_C, atol=1e-12)
    assert poses.parents.keys() == {"bubble"}  # the camera may have a parent on the robot


def test_each_of_two_sensors_has_a_camera_frame_of_its_own():
    frame = Frame(0, 0.0, np.full((4, 6), 0.1, np.float32), stamp_ns=1)
    named = set()
    for prefix in ("/left", "/robot/right/"):
        (image,) = FrameMessages(prefix=prefix).of(frame)
        named.add(STORE.deserialize_cdr(image.payload, image.type).header.frame_id)
    assert named == {"left_depth_optical_frame", "robot_right_depth_optical_frame"}
