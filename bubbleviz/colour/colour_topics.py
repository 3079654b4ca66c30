"""Which topic of a recording has the colour images of a sensor, and where their camera is."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.colour.colour_image import ColourCamera, EncodedImage
from bubbleviz.errors import InputError
from bubbleviz.frames.bags import Bag, Topic
from bubbleviz.frames.depth_topics import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    common_prefix,
    find_intrinsics,
    of_type,
)

TRANSFORMS = "tf2_msgs/msg/TFMessage"
STATIC_TRANSFORMS = "/tf_static"
"""Topic of the poses of frames of reference that do not move."""

_COLOUR_WORDS = ("color", "colour", "rgb")
_MOST_LINKS = 100
"""Between a frame of reference and its root; more are a loop."""


def find_colour(bag: Bag, depth: Topic, name: str | None = None) -> Topic | None:
    """Topic of the colour images: `name`, or that of the sensor with the depth images `depth`.

    None where there is none; InputError where `name` has no colour images.
    """
    found = [
        topic
        for kind in (IMAGE, COMPRESSED_IMAGE)
        for topic in of_type(bag, kind, name)
        if name is not None or belongs_to(topic.name, depth.name)
    ]
    found.sort(key=lambda topic: not is_called_colour(topic.name))
    for topic in found:
        if size_of(bag.messages(topic).message(0)) is not None:
            return topic
    if name is not None:
        raise InputError(f"{bag.path}: no colour images on topic {name}; see bubbleviz info")
    return None


def size_of(message: Any) -> tuple[int, int] | None:
    """Width and height of a colour or grey image, pixels; None of anything else."""
    try:
        return EncodedImage.of(message).size
    except ValueError:
        return None


def belongs_to(colour: str, depth: str) -> bool:
    """Whether images on a topic may be of the sensor with depth images on the other.

    Both are in one namespace: `/bubble_1` of `/bubble_1/color/image_raw` and `/bubble_1/depth/…`.
    """
    return colour != depth and _namespace(colour, _COLOUR_WORDS) == _namespace(depth, ("depth",))


def is_called_colour(topic: str) -> bool:
    """Whether the name of a topic says that its images are in colour."""
    return any(word in topic.lower() for word in _COLOUR_WORDS)


def _namespace(topic: str, words: tuple[str, ...]) -> str:
    """What stands before the part with one of the words, or before the last part."""
    parts = topic.split("/")
    said = (k for k, part in enumerate(parts) if any(word in part.lower() for word in words))
    namespace = "/".join(parts[: next(said, len(parts) - 1)])
    return re.sub(r"/sensor_\d+$", "", namespace)  # two sensors of one RealSense camera


def find_camera(bag: Bag, colour: Topic, depth: Topic) -> ColourCamera:
    """Camera of the colour images: intrinsics of their size that are nearest by name, and pose."""
    first = bag.messages(colour).message(0)
    size = size_of(first)
    intrinsics = None if size is None else find_intrinsics(bag, colour, size)
    frames = first.header.frame_id, bag.messages(depth).message(0).header.frame_id
    pose = np.eye(4) if frames[0] == frames[1] else _relative_pose(bag, *frames)
    own = any(
        common_prefix(info.name, colour.name) >= common_prefix(info.name, depth.name)
        for info in of_type(bag, CAMERA_INFO)
    )
    return colour_camera(intrinsics, pose, own=own)


def colour_camera(
    intrinsics: Intrinsics | None, T_D_C: np.ndarray | None, *, own: bool
) -> ColourCamera:
    """Camera of what is known of it; what is not is said, as intrinsics that are not its own."""
    remarks = []
    if intrinsics is None:
        remarks.append("no camera info of its size")
    elif not own:
        remarks.append("no camera info: that of the depth camera counts")
    if T_D_C is None:
        remarks.append(f"no pose in {STATIC_TRANSFORMS}: taken to be where the depth camera is")
    return ColourCamera(intrinsics, np.eye(4) if T_D_C is None else T_D_C, "; ".join(remarks))


def _relative_pose(bag: Bag, frame: str, base: str) -> np.ndarray | None:
    """T_base_frame (4, 4) by the static transforms; None where they do not connect the two."""
    parents: dict[str, tuple[str, np.ndarray]] = {}
    for topic in of_type(bag, TRANSFORMS, STATIC_TRANSFORMS):
        messages = bag.messages(topic)
        for k in range(len(messages)):
            for each in messages.message(k).transforms:
                pose = _matrix(each.transform)
                parents[_bare(each.child_frame_id)] = (_bare(each.header.frame_id), pose)
    to_root, to_base = _chain(_bare(frame), parents), _chain(_bare(base), parents)
    for name, pose in to_root.items():
        if name in to_base:
            return np.asarray(np.linalg.solve(to_base[name], pose))
    return None


def _chain(frame: str, parents: dict[str, tuple[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Pose of a frame in itself and in each of those above it."""
    found = {frame: np.eye(4)}
    for _ in range(_MOST_LINKS):
        if frame not in parents:
            break
        above, pose = parents[frame]
        found[above] = pose @ found[frame]
        frame = above
    return found


def _bare(frame_id: str) -> str:
    return frame_id.lstrip("/")


def _matrix(transform: Any) -> np.ndarray:
    q, t = transform.rotation, transform.translation
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    pose[:3, 3] = t.x, t.y, t.z
    return pose
