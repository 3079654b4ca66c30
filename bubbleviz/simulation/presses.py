"""Presses for studies: object, depth, and a pose drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.errors import InputError
from bubbleviz.files import presets_folder
from bubbleviz.membrane import MembraneMesh, TriangleScene
from bubbleviz.rigid_object import RigidObject, load_object

# Paths of an object that is pressed in, dragged sideways and twisted.


_MIN_FRAMES = 10
_MAX_DRAG_M, _MAX_TWIST_RAD = 0.05, np.pi  # larger values are in a wrong unit
_CLEARANCE_M = 1e-3  # initial distance between object and membrane
_WAITED, _PRESSED, _DRAGGED, _TWISTED = 0.15, 0.4, 0.65, 0.9
"""Ends of waiting, pressing, dragging and twisting, over the duration; then the object is held."""


def press_path(
    obj: RigidObject,
    T_B_O: np.ndarray,  # (4, 4), pose at the end of the press along −z of B
    mesh: MembraneMesh,  # at rest
    frames: int,  # 10 or more: 15 % contact-free, then 25 % each for press, drag and twist
    drag_m: float = 0.0,  # along x of B
    twist_rad: float = 0.0,  # about the z axis of the object
) -> np.ndarray:
    """Poses T_B_O (frames, 4, 4): clear of the membrane, pressed in, dragged, twisted, held.

    Raises InputError: fewer frames, or drag or twist out of range.
    """
    if frames < _MIN_FRAMES:
        raise InputError(
            f"--frames {frames}: too few for drag and twist; give at least {_MIN_FRAMES}"
        )
    if not abs(drag_m) <= _MAX_DRAG_M:
        raise InputError(f"drag {drag_m:g} m: give at most ±{_MAX_DRAG_M:g} m (--drag-m)")
    if not abs(twist_rad) <= _MAX_TWIST_RAD:
        raise InputError(f"twist {twist_rad:g} rad: give at most ±π rad, ±180° (--twist-rad)")
    t = np.arange(frames) / (frames - 1)
    above = max(touching_height(obj, T_B_O, mesh) - T_B_O[2, 3], 0.0) + _CLEARANCE_M
    poses = np.tile(T_B_O, (frames, 1, 1))
    poses[:, 2, 3] += above * (1.0 - _ramp(t, _WAITED, _PRESSED))
    poses[:, 0, 3] += drag_m * _ramp(t, _PRESSED, _DRAGGED)
    turns = np.zeros((frames, 3))
    turns[:, 2] = twist_rad * _ramp(t, _DRAGGED, _TWISTED)
    poses[:, :3, :3] = T_B_O[:3, :3] @ Rotation.from_rotvec(turns).as_matrix()
    return poses


def _ramp(t: np.ndarray, start: float, end: float) -> np.ndarray:
    return np.clip((t - start) / (end - start), 0.0, 1.0)


def touching_height(obj: RigidObject, T_B_O: np.ndarray, mesh: MembraneMesh) -> float:
    """Height z of O at which the object, lowered along −z, first touches the membrane, m."""
    vertices = obj.vertices @ T_B_O[:3, :3].T + [*T_B_O[:2, 3], 0.0]
    above_nodes = _vertical_distance(mesh.nodes, 1.0, vertices, obj.triangles)
    below_vertices = _vertical_distance(vertices, -1.0, mesh.nodes, mesh.triangles)
    return -float(min(above_nodes.min(), below_vertices.min()))


def _vertical_distance(
    points: np.ndarray, up: float, vertices: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Signed distance in m from points (k, 3) along ±z to a mesh; inf if the ray misses it."""
    rays = np.zeros((len(points), 6))
    rays[:, :3], rays[:, 5] = points, up
    rays[:, 2] -= up  # start 1 m away, for negative distances of overlapping bodies
    return TriangleScene(vertices, triangles).cast(rays).distance - 1.0


GRID_OBJECTS = ("frustum", "two_legged_toy", "bridge", "sphere", "torus", "two_spheres")
HELD_OUT_OBJECTS = ("cross", "cylinder", "hex_nut")
"""Not used for choosing the estimator's settings."""
SMOOTH_OBJECTS = ("sphere", "puck")
"""Objects without sharp edges, whose equilibrium converges with mesh refinement."""

_MAX_OFFSET_M = 0.008  # from the axis; chosen
_MAX_TILT_RAD = 0.14  # 8°; chosen


@dataclass(frozen=True)
class Press:
    """One object pressed to one depth."""

    object_name: str  # for `study_object`
    depth_m: float  # beyond first touch, along −z of B
    held_out: bool

    def pose(self, mesh: MembraneMesh, seed: int) -> np.ndarray:
        """Random T_B_O (4, 4): any rotation about z, up to 8 mm of offset and 8° of tilt."""
        text = f"{Path(self.object_name).stem} {round(1e6 * self.depth_m)}"
        random = np.random.default_rng([seed, *text.encode()])
        yaw, tilt_direction, offset_direction = random.uniform(0.0, 2.0 * np.pi, 3)
        tilt = _MAX_TILT_RAD * random.random()
        offset = _MAX_OFFSET_M * np.sqrt(random.random())
        axis = np.array([np.cos(tilt_direction), np.sin(tilt_direction), 0.0])
        rotation = Rotation.from_rotvec(tilt * axis) * Rotation.from_euler("z", yaw)
        pose = np.eye(4)
        pose[:3, :3] = rotation.as_matrix()
        pose[:2, 3] = offset * np.array([np.cos(offset_direction), np.sin(offset_direction)])
        pose[2, 3] = touching_height(study_object(self.object_name), pose, mesh) - self.depth_m
        return pose


def study_object(name: str) -> RigidObject:
    """Object by name: one for studies only (cross, bar, puck), a preset, or a mesh file."""
    own = Path(__file__).with_name("objects"), presets_folder("objects")
    paths = [*(folder / f"{name}.ply" for folder in own), Path(name)]
    return load_object(next((path for path in paths if path.is_file()), name))


def presses(names: tuple[str, ...], depths_m: tuple[float, ...]) -> list[Press]:
    """Every object at every depth."""
    return [Press(n, d, n in HELD_OUT_OBJECTS) for n in names for d in depths_m]
