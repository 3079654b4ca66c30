"""Poses of frames of reference that do not move, as `/tf_static` tells them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

TRANSFORMS = "tf2_msgs/msg/TFMessage"
STATIC_TRANSFORMS = "/tf_static"

_MOST_LINKS = 100
"""Between a frame of reference and its root; more are a loop."""


def are_static_poses(topic: str, kind: str) -> bool:
    """Whether messages of a topic and type tell them."""
    return topic == STATIC_TRANSFORMS and kind == TRANSFORMS


@dataclass(frozen=True)
class StaticPoses:
    """What is known so far.

    Attributes
    ----------
    parents : dict
        Of each frame of reference the one above it, and its pose (4, 4) in that.
    """

    parents: Mapping[str, tuple[str, np.ndarray]] = field(default_factory=dict)

    def after(self, message: Any) -> StaticPoses:
        """These and those of a `tf2_msgs/TFMessage`, which win."""
        told = {
            _bare(each.child_frame_id): (_bare(each.header.frame_id), pose_of(each.transform))
            for each in message.transforms
        }
        return StaticPoses({**self.parents, **told})

    def pose(self, frame: str, base: str) -> np.ndarray | None:
        """T_base_frame (4, 4); None where the two are not connected, or not named."""
        frame, base = _bare(frame), _bare(base)
        if not frame or not base:
            return None
        to_root, to_base = self._chain(frame), self._chain(base)
        for name, pose in to_root.items():
            if name in to_base:
                return np.asarray(np.linalg.solve(to_base[name], pose))
        return None

    def _chain(self, frame: str) -> dict[str, np.ndarray]:
        """Pose of a frame in itself and in each of those above it."""
        found = {frame: np.eye(4)}
        for _ in range(_MOST_LINKS):
            if frame not in self.parents:
                break
            above, pose = self.parents[frame]
            found[above] = pose @ found[frame]
            frame = above
        return found


def pose_of(transform: Any) -> np.ndarray:
    """A `geometry_msgs/Transform` as a matrix (4, 4)."""
    q, t = transform.rotation, transform.translation
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    pose[:3, 3] = t.x, t.y, t.z
    return pose


def _bare(frame_id: str) -> str:
    return frame_id.lstrip("/")
