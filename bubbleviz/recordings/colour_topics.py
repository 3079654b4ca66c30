"""Select the colour topic of a sensor in a recording, and find the pose of its camera."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bubbleviz.camera import ColourCamera, EncodedImage, Intrinsics
from bubbleviz.files import transform
from bubbleviz.recordings.bag import Bag, Topic
from bubbleviz.recordings.depth_topics import (
    COMPRESSED_IMAGE,
    IMAGE,
    common_prefix,
    find_intrinsics,
    has_data,
    of_type,
)

# Static poses between frames of reference, from `/tf_static`.


TRANSFORMS = "tf2_msgs/msg/TFMessage"
STATIC_TRANSFORMS = "/tf_static"

_MAX_POSES = 10_000  # most poses kept, the latest ones
_MAX_NAMES = 1000  # most letters of both names of a pose
_MAX_LINKS = 100  # between a frame of reference and its root; more are a loop


def are_static_poses(topic: str, kind: str) -> bool:
    """Whether a topic of this name and type has static poses."""
    return topic == STATIC_TRANSFORMS and kind == TRANSFORMS


@dataclass(frozen=True)
class StaticPoses:
    """Tree of the static poses received so far."""

    # parent of each frame of reference, and its pose (4, 4) in the parent
    parents: Mapping[str, tuple[str, np.ndarray]] = field(default_factory=dict)

    def after(self, message: Any) -> StaticPoses:
        received = {
            _bare(each.child_frame_id): (_bare(each.header.frame_id), pose_of(each.transform))
            for each in message.transforms
            if len(each.child_frame_id) + len(each.header.frame_id) <= _MAX_NAMES
        }
        known = {name: pose for name, pose in self.parents.items() if name not in received}
        latest = list({**known, **received}.items())[-_MAX_POSES:]
        return StaticPoses(dict(latest))

    def pose(self, frame: str, base: str) -> np.ndarray | None:
        """T_base_frame (4, 4); None if the two are not connected or have no name."""
        frame, base = _bare(frame), _bare(base)
        if not frame or not base:
            return None
        to_root, to_base = self._chain(frame), self._chain(base)
        for name, pose in to_root.items():
            if name in to_base:
                return np.asarray(np.linalg.solve(to_base[name], pose))
        return None

    def _chain(self, frame: str) -> dict[str, np.ndarray]:
        """Pose of a frame in itself and in each of its ancestors."""
        found = {frame: np.eye(4)}
        for _ in range(_MAX_LINKS):
            if frame not in self.parents:
                break
            above, pose = self.parents[frame]
            found[above] = pose @ found[frame]
            frame = above
        return found


def pose_of(message: Any) -> np.ndarray:
    """A `geometry_msgs/Transform` as a matrix (4, 4)."""
    q, t = message.rotation, message.translation
    return transform([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])


def _bare(frame_id: str) -> str:
    return frame_id.lstrip("/")


TRANSFORM = "geometry_msgs/msg/Transform"

_COLOUR_WORDS = ("color", "colour", "rgb")
_REALSENSE_STREAM = re.compile(r"(/device_\d+/sensor_\d+/\w+_\d+)/image/data")
"""Topic of images in a `.bag` of the RealSense library."""


def find_colour(bag: Bag, depth: Topic) -> Topic | None:
    """Topic of the colour images of the sensor with the depth images `depth`; None without any."""
    found = [
        topic
        for kind in (IMAGE, COMPRESSED_IMAGE)
        for topic in of_type(bag, kind)
        if belongs_to(topic.name, depth.name)
    ]
    found.sort(key=lambda topic: not is_called_colour(topic.name))
    readable = (t for t in found if size_of(bag.messages(t).first(has_data)) is not None)
    return next(readable, None)


def size_of(message: Any) -> tuple[int, int] | None:
    """Width and height of a colour or grey image, pixels; None for other messages."""
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
    """Whether the name of a topic contains a word for colour."""
    return any(word in topic.lower() for word in _COLOUR_WORDS)


def _namespace(topic: str, words: tuple[str, ...]) -> str:
    """Topic name before the part with one of the words, or before the last part."""
    parts = topic.split("/")
    named = (k for k, part in enumerate(parts) if any(word in part.lower() for word in words))
    namespace = "/".join(parts[: next(named, len(parts) - 1)])
    return re.sub(r"/sensor_\d+$", "", namespace)  # two sensors of one RealSense camera


def find_camera(bag: Bag, colour: Topic, depth: Topic) -> ColourCamera:
    """Camera of the colour images: intrinsics of their size that are nearest by name, and pose."""
    size = size_of(bag.messages(colour).first(has_data))
    info, intrinsics = find_intrinsics(bag, colour, size)
    pose = _relative_pose(bag, colour, depth)
    return colour_camera(intrinsics, pose, own=is_own(info, colour.name, depth.name))


def is_own(info: str, colour: str, depth: str) -> bool:
    """Whether a camera info is, by its topic, of the colour camera and not of the depth camera."""
    return info != "" and common_prefix(info, colour) >= common_prefix(info, depth)


def colour_camera(
    intrinsics: Intrinsics | None, T_D_C: np.ndarray | None, *, own: bool
) -> ColourCamera:
    """Colour camera from camera info and poses, with a remark on missing and assumed values."""
    remarks = []
    if intrinsics is None:
        remarks.append("no calibrated camera info of this image size")
    elif not own:
        remarks.append("no colour camera info of this image size; using the depth camera's")
    if T_D_C is None:
        remarks.append(
            f"no pose relative to the depth camera (in ROS from {STATIC_TRANSFORMS}); assuming the "
            "depth camera's pose"
        )
    pose = np.eye(4) if T_D_C is None else T_D_C
    placed = T_D_C is not None
    return ColourCamera(intrinsics, pose, "; ".join(remarks), own=own, placed=placed)


def _relative_pose(bag: Bag, colour: Topic, depth: Topic) -> np.ndarray | None:
    """T_D_C (4, 4) from the recorded poses; None if they do not connect the two cameras."""
    if any(_REALSENSE_STREAM.fullmatch(topic.name) for topic in (colour, depth)):
        # its images name no frame, but each stream has the pose of a reference in its camera
        ours, depths = (_extrinsics(bag, topic) for topic in (colour, depth))
        shared = ours.keys() & depths.keys()
        return next((depths[each] @ np.linalg.inv(ours[each]) for each in shared), None)
    poses = StaticPoses()
    for topic in of_type(bag, TRANSFORMS, STATIC_TRANSFORMS):
        messages = bag.messages(topic)
        for k in range(len(messages)):
            poses = poses.after(messages.message(k))
    frames = (bag.messages(topic).first().header.frame_id for topic in (colour, depth))
    return poses.pose(*frames)


def _extrinsics(bag: Bag, image: Topic) -> dict[str, np.ndarray]:
    """Pose (4, 4) of each reference, by its number, in the camera of a stream."""
    stream = _REALSENSE_STREAM.fullmatch(image.name)
    prefix = f"{stream[1]}/tf/" if stream else "\0"
    return {
        topic.name.removeprefix(prefix): pose_of(bag.messages(topic).first())
        for topic in of_type(bag, TRANSFORM)
        if topic.name.startswith(prefix)
    }
