"""Presses for studies: which object, how deep, and where, from a seed."""

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


FEWEST = 10  # frames of a path at least
MOST_DRAG_M, MOST_TWIST_RAD = 0.05, np.pi  # beyond these a unit is taken for another
_CLEAR_M = 1e-3  # height above first touch at which the object waits
_TOUCHES, _PRESSED, _DRAGGED, _TWISTED = 0.15, 0.4, 0.65, 0.9
"""Ends of waiting, pressing, dragging and twisting, over the time of the path; then it holds."""


def press_path(
    obj: RigidObject,
    T_B_O: np.ndarray,  # (4, 4), where it is pressed to, along −z of B
    mesh: MembraneMesh,  # at rest
    frames: int,  # 10 or more: the first 15 % contact-free, then 25 % for each of the three, evenly
    drag_m: float = 0.0,  # way along x of B, m
    twist_rad: float = 0.0,  # turn about the z axis of the object through its origin, rad
) -> np.ndarray:
    """Poses T_B_O (frames, 4, 4): clear of the membrane, pressed in, dragged, twisted, held.

    Raises InputError: fewer frames, or a way or turn that is out of range.
    """
    if frames < FEWEST:
        raise InputError(f"{frames} frames: drag and twist need {FEWEST} or more")
    if not abs(drag_m) <= MOST_DRAG_M:
        raise InputError(f"drag {1e3 * drag_m:g} mm: give at most {1e3 * MOST_DRAG_M:g} mm")
    if not abs(twist_rad) <= MOST_TWIST_RAD:
        raise InputError(f"twist {np.degrees(twist_rad):g}°: give at most 180°")
    t = np.arange(frames) / (frames - 1)
    above = max(touching_height(obj, T_B_O, mesh) - T_B_O[2, 3], 0.0) + _CLEAR_M
    poses = np.tile(T_B_O, (frames, 1, 1))
    poses[:, 2, 3] += above * (1.0 - _ramp(t, _TOUCHES, _PRESSED))
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
    """Signed way in m from points (k, 3) along ±z to the first of a mesh; inf beside it."""
    rays = np.zeros((len(points), 6))
    rays[:, :3], rays[:, 5] = points, up
    rays[:, 2] -= up  # start 1 m away, so that overlapping bodies count too
    return TriangleScene(vertices, triangles).cast(rays).distance - 1.0


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
