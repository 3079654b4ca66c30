"""Select the depth topic of a recording and the topics that belong to it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bubbleviz.camera import Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.files import as_input_error
from bubbleviz.recordings.bag import Bag, Topic
from bubbleviz.recordings.message_decoding import (
    COMPRESSED,
    DEPTH_ENCODINGS,
    REALSENSE_ENCODING,
    decode_intrinsics,
)

IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
PRESSURE = "sensor_msgs/msg/FluidPressure"
WRENCH = "geometry_msgs/msg/WrenchStamped"


RESULTS = "/bubbleviz/"
"""Prefix of the topics of bubbleviz's results, which are not measurements."""
MARKERS = f"{RESULTS}markers"  # topic of markers and notes, `STRING`, logged when they were made
STRING = "std_msgs/msg/String"


_REALSENSE_DEPTH = re.compile(r"(/device_\d+/sensor_\d+)/Depth_\d+/image/data")
"""Topic of depth images in a file of the RealSense library."""


def metres_per_unit(bag: Bag, depth: Topic) -> float | None:
    """Unit of depth images recorded by the RealSense library; None for others."""
    found = _REALSENSE_DEPTH.fullmatch(depth.name)
    if found is None:
        return None
    name = f"{found[1]}/option/Depth_Units/value"
    for topic in bag.topics:
        if topic.name.replace(" ", "_") == name and topic.count:  # older libraries wrote a space
            return float(bag.messages(topic).message(0).data)
    return 1e-3  # default of every model but the D405


def depth_topics(bag: Bag) -> list[str]:
    """Names of the image topics with a depth encoding and `depth` in their name."""
    images = [topic for topic in of_type(bag, IMAGE) if "depth" in topic.name.lower()]
    return [each.name for each in images if _is_depth(each.name, _first(bag, each).encoding)]


def find_depth(bag: Bag, name: str | None = None) -> tuple[Topic, str]:
    """Topic of the depth images, and a text about others like it, which may be empty.

    The topic is `name`, or the first image topic with a depth encoding. One with `depth` in its
    name is preferred: infrared images are 16UC1 too. Next come compressed depth images, then point
    clouds.
    """
    candidates = of_type(bag, IMAGE, name)
    candidates.sort(key=lambda topic: "depth" not in topic.name.lower())
    encodings = {topic.name: _first(bag, topic).encoding for topic in candidates}
    found = [topic for topic in candidates if _is_depth(topic.name, encodings[topic.name])]
    if found:
        others = [topic.name for topic in found[1:] if "depth" in topic.name.lower()]
        note = f"of several depth topics {found[0].name} is used, not {', '.join(others)}"
        remedy = "choose one by --depth-topic (Python: depth_topic of bv.open; window: File menu)"
        return found[0], f"{note}; {remedy}" if others else ""
    return _find_other_depth(bag, name, candidates, encodings), ""


def _is_depth(name: str, encoding: str) -> bool:
    realsense = encoding == REALSENSE_ENCODING and _REALSENSE_DEPTH.fullmatch(name) is not None
    return encoding in DEPTH_ENCODINGS or realsense


def _find_other_depth(
    bag: Bag, name: str | None, candidates: list[Topic], encodings: Mapping[str, str]
) -> Topic:
    """Topic of compressed depth images or point clouds; without one the reason is raised."""
    for topic in of_type(bag, COMPRESSED_IMAGE, name):
        if COMPRESSED in _first(bag, topic).format:
            return topic
    clouds = of_type(bag, POINT_CLOUD, name)
    if clouds:
        return clouds[0]
    if candidates:
        first = candidates[0].name
        raise InputError(
            f"{bag.path}: no depth images: {first} has encoding {encodings[first][:40]!r}; "
            f"{'record' if name is None else 'choose a topic of'} depth images with encoding "
            f"{' or '.join(DEPTH_ENCODINGS)}"
        )
    raise InputError(
        f"{bag.path}: no topic with depth images or point clouds has messages; record the depth "
        "camera's topic"
        if name is None
        else f"{bag.path}: no depth images or point clouds on topic {name}; choose another topic "
        "from bubbleviz info"
    )


def has_data(message: Any) -> bool:
    """Whether a message of an image or a cloud is not empty."""
    return len(message.data) > 0


def _first(bag: Bag, topic: Topic) -> Any:
    return bag.messages(topic).first(has_data)


def of_type(bag: Bag, kind: str, name: str | None = None) -> list[Topic]:
    """Topics of a message type that have messages: all, or the named one."""
    return [
        topic
        for topic in bag.topics
        if topic.type == kind
        and topic.count
        and (topic.name == name or (name is None and not topic.name.startswith(RESULTS)))
    ]


def first_of_type(bag: Bag, kind: str, name: str | None = None, near: str = "") -> Topic | None:
    """Topic of a message type: `name`, or the one most similar to `near` in name.

    None if there is none; InputError if `name` is not such a topic.
    """
    topics = of_type(bag, kind, name)
    topics.sort(key=lambda topic: common_prefix(topic.name, near), reverse=True)
    if name is not None and not topics:
        raise InputError(
            f"{bag.path}: no {kind} messages on topic {name}; choose a topic of this type from "
            "bubbleviz info, or none"
        )
    return topics[0] if topics else None


def find_intrinsics(
    bag: Bag, images: Topic, size: tuple[int, int] | None, name: str | None = None
) -> tuple[str, Intrinsics | None]:
    """Topic and intrinsics of the CameraInfo that belongs to images of a size (width, height).

    An empty topic if the recording has no CameraInfo for this camera.
    """
    if name is not None:
        first_of_type(bag, CAMERA_INFO, name)
    infos = {t.name: bag.messages(t).first() for t in of_type(bag, CAMERA_INFO, name)}
    found = nearest_info(infos, images.name, size)
    if not found:
        return "", None
    remedy = "correct the camera's calibration and record again"
    with as_input_error(bag.path, f"the camera info on {found}", remedy):
        return found, decode_intrinsics(infos[found])


def nearest_info(infos: Mapping[str, Any], images: str, size: tuple[int, int] | None) -> str:
    """Topic of the camera infos or intrinsics that is most similar to the images' in name.

    Empty if none has the size of the images.
    """
    fitting = [topic for topic, info in infos.items() if (info.width, info.height) == size]
    return max(fitting, key=lambda topic: common_prefix(topic, images), default="")


def common_prefix(a: str, b: str) -> int:
    """Number of name parts that two topics share from the left."""
    parts = zip(a.split("/"), b.split("/"), strict=False)
    return next((k for k, (x, y) in enumerate(parts) if x != y), 99)
