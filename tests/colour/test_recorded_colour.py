"""Colour images of a recording: right topic, right time, read only on demand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.api.frames import info
from bubbleviz.recordings import Messages, Recording
from tests.colour.colour_bag import COLOUR, add_colour, add_compressed, add_pose, encoded, picture
from tests.recordings.bagmaker import KINDS, PERIOD, START, BagMaker, depth_image, fill
from tests.recordings.realsense_bag import write_realsense_bag


def coloured(kind="mcap file", late=0, every=1):
    """The small press, with an image at every n-th of its frames or later by a share."""
    bag = fill(BagMaker(kind))
    for k in range(0, 6, every):
        add_colour(bag, START + k * PERIOD + late, k)
    return bag


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_has_the_images_that_were_written(tmp_path, kind):
    with Recording(coloured(kind, PERIOD // 5).write(tmp_path)) as recording:
        for k in (5, 0, 3, 3):
            colour = recording[k].colour
            np.testing.assert_array_equal(colour.rgb(), picture(k))
            assert colour.stamp_ns == START + k * PERIOD + PERIOD // 5
            assert colour.time_s == pytest.approx(recording.times_s[k] + 0.2e-9 * PERIOD)


@pytest.mark.parametrize("kind", ["jpeg", "png"])
def test_compressed_images_are_found(tmp_path, kind):
    bag = fill(BagMaker("mcap file"))
    for k in range(6):
        data = encoded(picture(k), kind)
        add_compressed(bag, START + k * PERIOD, data, f"rgb8; {kind} compressed bgr8")
        add_compressed(bag, START + k * PERIOD, b"x", "16UC1; compressedDepth", "/cam/depth/image")
    with Recording(bag.write(tmp_path)) as recording:
        assert (recording.colour.encoding, recording.colour.size) == (kind, (32, 24))
        colour = recording[4].colour
        np.testing.assert_allclose(colour.rgb(), picture(4).astype(float), atol=6.0)


def test_a_frame_has_the_nearest_image_within_half_a_period_or_none(tmp_path):
    """Time stamps of the headers decide, not log times."""
    bag = fill(BagMaker("mcap file"))
    for k, shift in enumerate((0.4, -0.4, 0.0)):
        late = START + (k + 7) * PERIOD
        add_colour(bag, START + 2 * k * PERIOD + round(shift * PERIOD), k, log=late)
    with Recording(bag.write(tmp_path)) as recording:
        found = [recording[k].colour for k in range(6)]
        assert [colour is not None for colour in found] == [True, False, True, False, True, False]
        for k in (0, 2, 4):
            np.testing.assert_array_equal(found[k].rgb(), picture(k // 2))


def test_each_time_has_its_own_image(tmp_path):
    with Recording(coloured().write(tmp_path)) as recording:
        period = 1e-9 * PERIOD
        colour = recording.colour_at(recording.times_s[5] - 2.3 * period)
        np.testing.assert_array_equal(colour.rgb(), picture(3))
        assert recording.colour_at(-2.0 * period) is None


@pytest.mark.parametrize(
    ("depth", "ours", "others"),
    [
        ("/bubble_1/depth/image", "/bubble_1/color/image", ["/bubble_2/color/image"]),
        ("/depth/image", "/rgb/image", ["/wrist/rgb/image"]),
        ("/cam/depth/image", "/cam/color/image", ["/cam/infra1/image", "/cam/a_first_look"]),
        (
            "/device_0/sensor_0/Depth_0/image/data",
            "/device_0/sensor_1/Color_0/image/data",
            ["/device_0/sensor_0/Infrared_1/image/data", "/device_1/sensor_1/Color_0/image/data"],
        ),
    ],
)
def test_the_colour_camera_is_that_of_the_sensor(tmp_path, depth, ours, others):
    bag = BagMaker("mcap file")
    bag.image(START, depth_image(0), topic=depth)
    for other in others:
        bag.image(START, picture(1)[..., 0], "mono8", topic=other)
    with Recording(bag.write(tmp_path, "alone")) as recording:
        named = recording.colour
        assert named is None or named.topic.name == "/cam/a_first_look"
    add_colour(bag, START, 0, ours)
    with Recording(bag.write(tmp_path, "both")) as recording:
        assert recording.colour.topic.name == ours


def test_colour_of_another_namespace_is_not_of_the_sensor(tmp_path):
    bag = fill(BagMaker("mcap file"))
    add_colour(bag, START, 2, "/elsewhere")
    with Recording(bag.write(tmp_path)) as recording:
        assert recording[0].colour is None


def test_the_camera_has_its_own_intrinsics_and_its_pose_in_the_depth_camera(tmp_path):
    """Both hang below the body of the camera; the chain is walked up and down."""
    bag = BagMaker("mcap file")
    bag.image(START, depth_image(0))
    bag.camera_info(START)
    matrix = np.array([50.0, 0, 15.5, 0, 51.0, 11.5, 0, 0, 1])
    bag.camera_info(START, topic="/cam/color/camera_info", k=matrix)
    header = bag.header(START)
    header.frame_id = "colour"
    add_colour(bag, START, 0, header=header)
    turned = Rotation.from_euler("y", 30, degrees=True)
    add_pose(bag, "body", "lens", (0.1, 0.0, 0.0))
    add_pose(bag, "lens", "colour", (0.0, 0.0, 0.02), tuple(turned.as_quat()))
    add_pose(bag, "body", "camera", (0.0, 0.3, 0.0), tuple(turned.as_quat()))
    with Recording(bag.write(tmp_path)) as recording:
        camera = recording.colour.camera
    assert (camera.intrinsics.fx, camera.remark) == (50.0, "")
    np.testing.assert_allclose(camera.T_D_C[:3, :3], np.eye(3), atol=1e-12)
    expected = turned.inv().apply([0.1, -0.3, 0.02])
    np.testing.assert_allclose(camera.T_D_C[:3, 3], expected, atol=1e-12)


def test_missing_camera_info_is_reported(tmp_path):
    bag = BagMaker("bag none")
    bag.image(START, depth_image(0))
    header = bag.header(START)
    header.frame_id = "colour"
    add_colour(bag, START, 0, header=header)
    with Recording(bag.write(tmp_path)) as recording:
        camera = recording.colour.camera
    assert camera.intrinsics is None
    assert "no calibrated camera info" in camera.remark
    assert "assuming the depth camera's pose" in camera.remark
    np.testing.assert_array_equal(camera.T_D_C, np.eye(4))


def test_pose_in_a_realsense_bag_equals_that_of_the_library(tmp_path):
    rs = pytest.importorskip("pyrealsense2")
    turns = Rotation.from_euler("xyz", [[10, 20, 30], [3, -5, 2]], degrees=True).as_quat()
    poses = {"Color_0": ((0.015, -0.01, 0.02), turns[0]), "Depth_0": ((1e-3, 2e-3, 3e-3), turns[1])}
    path = tmp_path / "camera.bag"
    write_realsense_bag(path, 1e-4, extrinsics=poses)
    device = rs.context().load_device(str(path))
    streams = [p for sensor in device.query_sensors() for p in sensor.get_stream_profiles()]
    by_name = {stream.stream_name(): stream for stream in streams}
    said = by_name["Color"].get_extrinsics_to(by_name["Depth"])
    with Recording(path) as recording:
        camera = recording.colour.camera
    np.testing.assert_allclose(camera.T_D_C[:3, :3].T.ravel(), said.rotation, atol=1e-6)
    np.testing.assert_allclose(camera.T_D_C[:3, 3], said.translation, atol=1e-7)
    assert "assuming the depth camera's pose" not in camera.remark


def test_depth_alone_reads_no_colour_images(tmp_path, monkeypatch):
    with Recording(coloured().write(tmp_path)) as recording:
        read: list[str] = []
        original = Messages.payload

        def noting(messages, k):
            read.append(messages.topic.name)
            return original(messages, k)

        monkeypatch.setattr(Messages, "payload", noting)
        frames = [recording[k] for k in range(6)]
        assert COLOUR not in read
        assert frames[2].colour is not None
        before = read.count(COLOUR)
        frames[2].colour.grey()
        assert read.count(COLOUR) > before


def test_info_lists_the_colour_images(tmp_path):
    with Recording(coloured(every=2).write(tmp_path)) as recording:
        facts = info(recording)
    assert (facts.colour.width, facts.colour.height, facts.colour.images) == (32, 24, 3)
    said = facts.to_text()
    assert "32 × 24 pixels, rgb8, /cam/color/image_raw; 3 images, 15.00 Hz" in said
    assert "no colour camera info of this image size" in said
