"""What `synthetic:` streams: an object and its path, by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.dual_nut import grip_poses, oversized_nut
from bubbleviz.simulation.synthetic_source import SyntheticSource, default_path, dome_size

LIVE_FINER = 2
"""Nodes of the live simulation's mesh for one of the estimator's: frames are made in 15 ms."""

DEFAULT_OBJECT = "two_legged_toy"


def simulation(
    place: str, sensor: Sensor, frames: int, noise: float, rate_hz: float, seed: int
) -> Callable[[], FrameSource]:
    """Maker of the simulation that the place of a source names.

    It is empty for the built-in press, an object's name or mesh file for the same press
    with that, `nut-left` or `nut-right` for a finger of the dual-finger task.

    Raises InputError: there is no such object.
    """
    obj, poses = _scene(place, sensor, frames)

    def make() -> FrameSource:
        return SyntheticSource(
            sensor,
            obj,
            poses,
            DepthNoise(relative=noise),
            rate_hz,
            seed,
            nodes=LIVE_FINER * sensor.membrane.nodes,
        )

    return make


def _scene(place: str, sensor: Sensor, frames: int) -> tuple[RigidObject, np.ndarray]:
    height, width = dome_size(sensor)
    if place in ("nut-left", "nut-right"):
        return oversized_nut(), grip_poses(
            "left" if place == "nut-left" else "right", height, frames
        )
    return load_object(place or DEFAULT_OBJECT), default_path(height, width, frames)
