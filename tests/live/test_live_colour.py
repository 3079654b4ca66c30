"""Live frames have colour images only after a request for them."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from realsense_file import record_realsense
from robot import HASH, open_session
from streams import frames_of, played, recorded
from wire import (
    IMAGE,
    INFO,
    NOW,
    PERIOD,
    SECOND,
    arrived,
    camera_info,
    depth,
    grey,
    header,
    image as wire_image,
    sent,
)
from zenoh import ext

from benchmarks.window.live_soak import free_port
from bubbleviz.errors import InputError
from bubbleviz.live import (
    FrameAssembler,
    Recorder,
    SessionOptions,
    TopicNames,
    ZenohPublisher,
    open_stream,
)
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import STATIC_TRANSFORMS, TRANSFORMS, Message, Recording, StaticPoses
from bubbleviz.sensor import with_colour_delay
from tests.colour.colour_bag import add_pose

COLOUR, JPEG = "/cam/color/image_raw", "sensor_msgs/msg/CompressedImage"


def level(frame, delay_s=0.0):
    image = replace(frame, colour_delay_s=delay_s).colour
    return None if image is None else int(image.grey()[5, 5])


def both(k, shift=0):
    """Depth image k, then the colour image of that time, and one of another sensor."""
    stamp = NOW + k * PERIOD
    return [
        depth(stamp, k, topic="/cam/depth/image"),
        grey(stamp, 200, "/other/color/image_raw"),
        grey(stamp + shift, k),
    ]


def following(*messages, **how):
    """An assembler that was asked for colour, and had these messages."""
    assembler = FrameAssembler(**how)
    assembler.follow_colour()
    for message in messages:
        assembler.push(message)
    return assembler


@pytest.mark.parametrize("shift", [0, PERIOD // 4, -PERIOD // 4])
def test_frame_has_the_colour_of_its_time_once_subscribed(shift):
    assembler = following()
    found = frames_of(assembler, *(m for k in range(8) for m in both(k, shift)))
    assert [level(frame) for frame in found[1:]] == list(range(1, 8))
    assert [level(frame, -2.1e-9 * PERIOD) for frame in found[3:]] == list(range(1, 6))
    image = found[4].colour
    assert image.time_s == pytest.approx(found[4].time_s + 1e-9 * shift)
    assert assembler.counters.undecodable == 0
    # nothing is taken before it is asked for
    assembler = FrameAssembler()
    found = frames_of(assembler, *(m for k in range(3) for m in both(k)))
    assert [frame.colour for frame in found] == [None] * 3
    assert assembler.counters.undecodable == 0


@pytest.mark.parametrize(("late", "seen"), [(50_000_000, 1), (200_000_000, None)])
def test_a_frame_waits_for_the_colour_of_its_time(late, seen):
    """A slow replay: the images of one moment arrive long after each other."""
    assembler = following(*both(0))
    stamp = NOW + PERIOD
    assert assembler.push(depth(stamp, 1, topic="/cam/depth/image")) == []
    until = assembler.waits_until_ns
    assert until is not None and until - stamp < SECOND // 5
    found = assembler.flush(min(until, stamp + late))
    image = grey(stamp, 1)
    found += assembler.push(arrived(COLOUR, image.type, image.payload, stamp, stamp + late))
    assert [level(frame) for frame in found] == [seen]


def test_a_newer_frame_ends_the_wait_for_colour():
    assembler = following(*both(0))
    assert assembler.push(depth(NOW + PERIOD, 1, topic="/cam/depth/image")) == []
    (frame,) = assembler.push(depth(NOW + 2 * PERIOD, 2, topic="/cam/depth/image"))
    assert frame.depth_m[0, 0] == pytest.approx(0.101)


@pytest.mark.parametrize("ahead", [0, 2, 14])
def test_colour_delay_pairs_simultaneous_frames(ahead, small_sensor):
    """Colour shows the scene `ahead` frames later; up to half a second of images is buffered."""
    delay_s = -1e-9 * ahead * PERIOD
    pipeline = Pipeline.of(with_colour_delay(small_sensor, delay_s))
    assembler = following(colour_delay_s=delay_s)
    found = frames_of(assembler, *(m for k in range(20) for m in both(k)))
    result = pipeline.process(replace(found[-1], colour_delay_s=0.0), frozenset({"cloud"}))
    again = pipeline.process(result.frame, frozenset({"cloud"}))
    for frame in (found[-1], result.frame, again.frame):
        assert int(frame.colour.grey()[5, 5]) == 19 - ahead


def test_a_frame_waits_for_a_colour_image_that_is_late():
    """Colour at twice the rate, delayed by 0.8 periods relative to depth."""
    delay_s = 0.8e-9 * PERIOD
    assembler = following(*both(0), colour_delay_s=delay_s)
    stamp = NOW + PERIOD
    assert assembler.push(depth(stamp, 1, topic="/cam/depth/image")) == []
    assert assembler.push(grey(stamp + PERIOD // 4, 11)) == []
    (frame,) = assembler.push(grey(stamp + 3 * PERIOD // 4 + PERIOD // 16, 12))
    assert level(frame, delay_s) == 12


def test_colour_camera_is_known_and_a_topic_can_be_chosen():
    info = arrived("/cam/depth/camera_info", INFO, camera_info(NOW), NOW)
    assembler = following()
    image = frames_of(assembler, info, *both(0), *both(1))[-1].colour
    assert image.camera.intrinsics is not None
    assert "using the depth camera's" in image.camera.remark
    # a named topic of another namespace counts
    assembler = following(names=TopicNames(colour="/other/color/image_raw"))
    found = frames_of(assembler, *(m for k in range(3) for m in both(k)))
    assert level(found[-1]) == 200


def test_undecodable_colour_is_reported_on_demand():
    assembler = following()
    messages = [*both(0), depth(NOW + PERIOD, 1, topic="/cam/depth/image")]
    broken = arrived(COLOUR, IMAGE, b"\0\1\0\0garbage", NOW + PERIOD)
    found = frames_of(assembler, *messages, broken)
    image = found[-1].colour
    with pytest.raises(InputError, match="correct its publisher"):
        image.grey()


@pytest.mark.parametrize("before", [True, False])
def test_recording_includes_colour(tmp_path, small_sensor, before):
    path = recorded(tmp_path / "rec.mcap", [m for k in range(5) for m in both(k)])
    recorder, copy = Recorder(), tmp_path / "copy.mcap"
    stream = open_stream(f"replay:{path}?speed=1000", small_sensor, any_size=True)
    if before:
        recorder.start(copy)
    recorder.listen_to(stream)
    if not before:
        recorder.start(copy)
    played(stream)
    recorder.stop()
    with Recording(copy) as recording:
        assert [level(recording[k]) for k in range(5)] == list(range(5))


def test_a_robot_sends_colour_only_to_subscribers(small_sensor):
    """Advertised, but not subscribed until requested; also when requested later."""
    port, topics = free_port(), {"depth/image": 0, "color/image_raw": 1}
    kind = f"sensor_msgs::msg::dds_::Image_/{HASH}"
    heard: list[Message] = []
    with open_session(str(port)) as robot:
        tokens = [
            robot.liveliness().declare_token(
                f"@ros2_lv/0/b3f7/0/1{number}/MP/%/%/camera/%cam%{name.replace('/', '%')}/{kind}/"
                "::,5:,:,:,,"
            )
            for name, number in topics.items()
        ]

        def send():
            stamp = time.time_ns()
            for message in both(0):
                name = message.topic.removeprefix("/cam/")
                payload = grey(stamp, 7).payload if "color" in name else wire_image(stamp)
                if name in topics:
                    robot.put(f"0/cam/{name}/{kind}", payload)

        with open_stream(f"zenoh:tcp/127.0.0.1:{port}", small_sensor) as stream:
            stream.listen(heard.append)
            while stream.counters.frames < 5:
                send()
                stream.take(0.02)
            assert not any(message.topic == COLOUR for message in heard)
            let_go = stream.follow_colour()
            frame = None
            while frame is None or frame.colour is None:
                send()
                frame = stream.take(0.02) or frame
            assert level(frame) == 7
            let_go()
            depth_alone = 0
            while depth_alone < 5:  # in a row, once it is subscribed to no more
                del heard[:]
                send()
                while not any("depth" in message.topic for message in heard):
                    stream.take(0.02)
                depth_alone = 0 if any("color" in m.topic for m in heard) else depth_alone + 1
            assert stream.counters.missed == 0
        assert tokens


def test_reason_for_missing_colour(tmp_path, small_sensor):
    """Not requested, awaited, or not available."""
    said = []
    for colours, asked in ((1, False), (1, True), (0, True)):
        messages = [depth(NOW + k * PERIOD, k, topic="/cam/depth/image") for k in range(3)]
        messages += colours * [grey(NOW + 3600 * SECOND, 3)]
        path = recorded(tmp_path / f"{len(said)}.mcap", messages)
        stream = open_stream(f"replay:{path}", small_sensor, any_size=True)
        if asked:
            stream.follow_colour()
        with stream:
            frame = stream.take(30.0)
        assert frame is not None and frame.colour is None
        said.append(frame.no_colour)
    assert said == [
        "colour images were not yet subscribed to when this frame arrived",
        f"waiting for colour images on {COLOUR}",
        "no colour images of this sensor in a known encoding",
    ]


@pytest.mark.parametrize(
    ("asked", "let_go", "comes"), [(0, 0, False), (1, 0, True), (2, 1, True), (2, 2, False)]
)
def test_a_replay_sends_colour_until_the_last_subscriber_leaves(
    asked, let_go, comes, tmp_path, small_sensor
):
    path = recorded(tmp_path / "rec.mcap", [m for k in range(3) for m in both(k)])
    stream = open_stream(f"replay:{path}?speed=1000", small_sensor, any_size=True)
    for forget in [stream.follow_colour() for _ in range(asked)][:let_go]:
        forget()
    heard: list[Message] = []
    stream.listen(heard.append)
    played(stream)
    assert any(message.topic == COLOUR for message in heard) is comes


def static_pose(parent, child, at_m):
    """T_parent_child: a quarter turn about z, on /tf_static."""
    turn = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
    return arrived(STATIC_TRANSFORMS, TRANSFORMS, sent(add_pose, parent, child, at_m, turn), 0)


def framed(stamp, k, frame_id):
    """A colour image in a frame of reference."""
    head = header(stamp)
    head.frame_id = frame_id
    return grey(stamp, k, header=head)


POSE = np.array(
    [[0.0, -1.0, 0.0, 0.01], [1.0, 0.0, 0.0, 0.02], [0.0, 0.0, 1.0, 0.03], [0, 0, 0, 1]]
)
"""Of `static_pose` at (0.01, 0.02, 0.03)."""


@pytest.mark.parametrize(
    ("frame_id", "pose", "remark"),
    [
        ("lens", POSE, False),
        (header(NOW).frame_id, np.eye(4), False),
        ("elsewhere", np.eye(4), True),
    ],
)
def test_pose_of_the_colour_camera_from_tf_static(frame_id, pose, remark):
    """Sent once, before colour is requested; a camera without a pose is reported."""
    assembler = FrameAssembler()
    assembler.push(static_pose(header(NOW).frame_id, "lens", (0.01, 0.02, 0.03)))
    assembler.follow_colour()
    stamps = [NOW + k * PERIOD for k in range(3)]
    messages = [
        m for s in stamps for m in (depth(s, topic="/cam/depth/image"), framed(s, 1, frame_id))
    ]
    camera = frames_of(assembler, *messages)[-1].colour.camera
    np.testing.assert_allclose(camera.T_D_C, pose, atol=1e-12)
    assert ("assuming the depth camera's pose" in camera.remark) is remark


def test_a_recording_and_its_replay_have_the_pose(tmp_path, small_sensor):
    """Although it was sent before the recording began."""
    recorder, stamps = Recorder(), [NOW + k * PERIOD for k in range(5)]
    recorder.push(static_pose(header(NOW).frame_id, "lens", (0.01, 0.02, 0.03)))
    messages = [
        m for s in stamps for m in (depth(s, topic="/cam/depth/image"), framed(s, 1, "lens"))
    ]
    path = recorded(tmp_path / "rec.mcap", messages, recorder)
    with Recording(path) as recording:
        np.testing.assert_allclose(recording.colour.camera.T_D_C, POSE, atol=1e-12)
    stream = open_stream(f"replay:{path}?speed=1000", small_sensor, any_size=True)
    stream.follow_colour()
    frame = played(stream)
    assert frame is not None and frame.colour is not None
    np.testing.assert_allclose(frame.colour.camera.T_D_C, POSE, atol=1e-12)


@pytest.mark.parametrize("ours", [False, True])
def test_a_static_pose_sent_before_connecting_is_received(ours, small_sensor):
    """As rmw_zenoh does for transient-local topics; our own publisher does the same."""
    port, pose = free_port(), static_pose("", "lens", (0.01, 0.02, 0.03))
    place, held = f"tcp/127.0.0.1:{port}", ExitStack()
    heard: list[Message] = []
    with held:
        if ours:
            out = held.enter_context(ZenohPublisher(SessionOptions("out", listen=place)))
            out.put(pose)
        else:
            robot, kind = (
                held.enter_context(open_session(str(port))),
                "tf2_msgs::msg::dds_::TFMessage_",
            )
            key = f"0/tf_static/{kind}/{HASH}"
            cached = ext.declare_advanced_publisher(
                robot, key, cache=ext.CacheConfig(1), publisher_detection=True
            )
            cached.put(pose.payload)
            token = robot.liveliness().declare_token(
                f"@ros2_lv/0/b3f7/0/11/MP/%/%/camera/%tf_static/{kind}/{HASH}/::,5:,:,:,,"
            )
        with open_stream(f"zenoh:{place}", small_sensor) as stream:
            stream.listen(heard.append)
            stream.follow_colour()
            deadline = time.monotonic() + 60.0
            while not heard and time.monotonic() < deadline:
                stream.take(0.1)
        if not ours:
            del token
    assert [(m.topic, m.payload) for m in heard] == [(pose.topic, pose.payload)]


RECORDED = 80
"""Images of each sensor in `realsense_file`: more than the source holds ready."""


@pytest.fixture(scope="module")
def realsense_file(tmp_path_factory):
    """Depth and colour of two sensors."""
    path = tmp_path_factory.mktemp("realsense") / "camera.db3"
    return record_realsense(path, RECORDED, POSE)


def test_colour_of_a_realsense_camera_subscribed_later(realsense_file, small_sensor):
    """After a few images the file begins again, with colour; let go of, that comes no more."""
    stream = open_stream(f"realsense:{realsense_file}?loop=1", small_sensor)
    heard: list[Message] = []
    let_go: list[Callable[[], None]] = []

    def ask(message):
        heard.append(message)
        if not let_go and len(heard) == 10:  # by then the source has read as far ahead as it does
            let_go.append(stream.follow_colour())

    stream.listen(ask)
    with stream:
        while (frame := stream.take(30.0)) is not None and frame.colour is None:
            pass
        k = round(1e4 * float(frame.depth_m[5, 5])) - 1000
        assert frame.colour.rgb()[5, 5].tolist() == [k, 2 * k, 3 * k]
        camera = frame.colour.camera
        assert camera.intrinsics is not None and (camera.intrinsics.fx, camera.remark) == (61, "")
        np.testing.assert_allclose(camera.T_D_C, POSE, atol=1e-6)
        assert not any("color" in message.topic for message in heard[:10])
        rounds = [message.round for message in heard if "depth" in message.topic]
        assert rounds.count(0) < RECORDED  # the first was not played to its end
        let_go[0]()
        del heard[:]
        while sum("depth" in message.topic for message in heard) < 10:
            stream.take(30.0)
        assert not any("color" in message.topic for message in heard[-5:])
        assert stream.counters.undecodable == 0


def test_repeated_static_poses_use_bounded_memory():
    """A publisher may send ever new coordinate frames; the latest transform is used."""
    poses = StaticPoses()
    for k in range(30):
        names = [f"a{k}_{i}" for i in range(1_000)]
        many = SimpleNamespace(transforms=[transform("base", name, 0.001 * k) for name in names])
        poses = poses.after(many)
    assert len(poses.parents) <= 10_000
    np.testing.assert_allclose(poses.pose("a29_999", "base")[:3, 3], [0.029, 0.0, 0.0])


def transform(parent, child, x_m):
    return SimpleNamespace(
        child_frame_id=child,
        header=SimpleNamespace(frame_id=parent),
        transform=SimpleNamespace(
            translation=SimpleNamespace(x=x_m, y=0.0, z=0.0),
            rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )
