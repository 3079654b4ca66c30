"""Scenes of `synthetic:` sources: an object and its path, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.recordings import FrameSource
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import SyntheticSource, default_path, dome_size, ease

# The paper's dual-finger task (V-C, Fig. 1): an oversized nut between two bubbles.
#
# World W: z is the nut's axis, the origin its centre; the fingers press its flats at ±y.


Side = Literal["left", "right"]

OVERSIZE = 2.0  # scale of the preset's nut: 48 mm across flats, a third of the bubble's width
PRESS = 0.2  # depth of the press by closed fingers, over the height of the dome
OPENING_M = 0.02  # of each finger before it closes; chosen
TURN_RAD = np.radians(12.0)  # rotation of the nut between the fingers


def oversized_nut() -> RigidObject:
    """The nut, with its centre at the origin."""
    nut = load_object("hex_nut")
    middle = 0.5 * (nut.vertices.min(axis=0) + nut.vertices.max(axis=0))
    return RigidObject(nut.name, OVERSIZE * (nut.vertices - middle), nut.triangles)


def finger_pose(side: Side, height_m: float, opening_m: float = 0.0) -> np.ndarray:
    """T_W_B (4, 4) of a finger that is open by `opening_m`, with a dome of height `height_m`."""
    out = -1.0 if side == "left" else 1.0
    half = 0.5 * float(np.ptp(oversized_nut().vertices[:, 1]))
    T = np.eye(4)
    T[:3, 0] = [1.0, 0.0, 0.0]
    T[:3, 1] = [0.0, 0.0, out]
    T[:3, 2] = [0.0, -out, 0.0]
    T[1, 3] = out * (half + (1.0 - PRESS) * height_m + opening_m)
    return T


def grip_poses(side: Side, height_m: float, frames: int) -> np.ndarray:
    """T_B_O (frames, 4, 4): the fingers close, the nut turns there and back, the fingers open."""
    t = np.arange(frames) / frames
    closed = ease(t, 0.08, 0.3) - ease(t, 0.75, 0.95)
    turn = TURN_RAD * np.sin(2.0 * np.pi * ease(t, 0.35, 0.7))
    poses = np.empty((frames, 4, 4))
    for k in range(frames):
        T_W_O = np.eye(4)
        T_W_O[:3, :3] = Rotation.from_rotvec([0.0, 0.0, turn[k]]).as_matrix()
        T_W_B = finger_pose(side, height_m, OPENING_M * (1.0 - closed[k]))
        poses[k] = np.linalg.inv(T_W_B) @ T_W_O
    return poses


LIVE_NODE_RATIO = 2
"""Nodes of the live simulation's mesh per node of the estimator's, for 15 ms per frame."""

DEFAULT_OBJECT = "two_legged_toy"


def simulation(
    place: str, sensor: Sensor, frames: int, noise: float, rate_hz: float, seed: int
) -> Callable[[], FrameSource]:
    """Factory of the simulation given by the `place` of a source URI.

    `place` is empty for the built-in press, an object's name or mesh file for the same press with
    that object, or `nut-left` or `nut-right` for a finger of the dual-finger task.

    Raises InputError: there is no such object.
    """
    scene, nodes = _scene(place, sensor, frames), LIVE_NODE_RATIO * sensor.membrane.nodes
    noises = DepthNoise(relative=noise)
    return partial(SyntheticSource, sensor, *scene, noises, rate_hz, seed, nodes=nodes)


def default_press(
    sensor: Sensor,
    frames: int = 150,  # of one loop, contact-free at both ends
    nodes: int | None = None,  # target number of nodes of the simulation's mesh
    noise: DepthNoise | None = None,  # None: that of the sensor's camera
    object_name: str = DEFAULT_OBJECT,
) -> SyntheticSource:
    """Press of the built-in live sensor: approach, press, move and turn, withdraw."""
    noise = noise or DepthNoise(relative=sensor.camera.noise_relative)
    return SyntheticSource(sensor, *_scene(object_name, sensor, frames), noise, nodes=nodes)


def _scene(place: str, sensor: Sensor, frames: int) -> tuple[RigidObject, np.ndarray]:
    height, width = dome_size(sensor)
    if place in ("nut-left", "nut-right"):
        return oversized_nut(), grip_poses(
            "left" if place == "nut-left" else "right", height, frames
        )
    return load_object(place or DEFAULT_OBJECT), default_path(height, width, frames)
