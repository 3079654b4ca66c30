"""Presses for studies: which object, how deep, and where, from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.files.preset_files import presets_folder
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.simulation.press_path import touching_height

GRID_OBJECTS = ("frustum", "two_legged_toy", "bridge", "sphere", "torus", "two_spheres")
HELD_OUT_OBJECTS = ("cross", "cylinder", "hex_nut")
"""Held-out objects: not used while choosing the estimator's settings."""
SMOOTH_OBJECTS = ("sphere", "puck")
"""Objects without sharp edges, whose exact equilibrium converges as the mesh becomes finer."""

LARGEST_OFFSET_M = 0.008  # off the axis, m; chosen
LARGEST_TILT_RAD = 0.14  # 8°; chosen


@dataclass(frozen=True)
class Press:
    """One object pressed to one depth."""

    object_name: str  # as of `made`
    depth_m: float  # how far beyond first touch, along −z of B
    held_out: bool

    def pose(self, mesh: MembraneMesh, seed: int) -> np.ndarray:
        """T_B_O (4, 4): any turn, up to 8 mm off the axis and 8° of tilt, all from the seed."""
        text = f"{Path(self.object_name).stem} {round(1e6 * self.depth_m)}"
        random = np.random.default_rng([seed, *text.encode()])
        turn, heading, aside = random.uniform(0.0, 2.0 * np.pi, 3)
        tilt = LARGEST_TILT_RAD * random.random()
        offset = LARGEST_OFFSET_M * np.sqrt(random.random())
        axis = np.array([np.cos(heading), np.sin(heading), 0.0])
        rotation = Rotation.from_rotvec(tilt * axis) * Rotation.from_euler("z", turn)
        pose = np.eye(4)
        pose[:3, :3] = rotation.as_matrix()
        pose[:2, 3] = offset * np.array([np.cos(aside), np.sin(aside)])
        pose[2, 3] = touching_height(made(self.object_name), pose, mesh) - self.depth_m
        return pose


def made(name: str) -> RigidObject:
    """Object of a name: one of the studies' own (a cross, a bar, a puck), a preset, or a file."""
    own = Path(__file__).with_name("objects"), presets_folder("objects")
    paths = [*(folder / f"{name}.ply" for folder in own), Path(name)]
    return load_object(next((path for path in paths if path.is_file()), name))


def presses(names: tuple[str, ...], depths_m: tuple[float, ...]) -> list[Press]:
    """Every object at every depth."""
    return [Press(n, d, n in HELD_OUT_OBJECTS) for n in names for d in depths_m]
