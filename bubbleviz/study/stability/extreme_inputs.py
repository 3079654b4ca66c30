"""Extreme objects, meshes and images for the stability study."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.rigid_object import RigidObject
from bubbleviz.study import object_shapes
from bubbleviz.study.object_shapes import ply_bytes, sphere


def needle() -> RigidObject:
    """Cone of 2 mm radius and 30 mm length with a tip of 0.05 mm."""
    return _stack("needle", [(5e-5, 5e-5, 0.0), (2e-3, 2e-3, 0.030)])


def blade() -> RigidObject:
    """Blade 40 mm long and 0.2 mm thick."""
    return _stack("blade", [(0.020, 1e-4, 0.0), (0.020, 1e-4, 0.020)])


def plate() -> RigidObject:
    """Plate wider than the sensor, 300 mm square and 5 mm thick."""
    return _stack("plate", [(0.15, 0.15, 0.0), (0.15, 0.15, 0.005)])


def pellet() -> RigidObject:
    """Ball of radius 4 mm: pressed deep enough it is wholly inside the dome."""
    return _scaled("pellet", 4.0 / 15.0)


def large_ball() -> RigidObject:
    """Ball of radius 60 mm, larger than the dome."""
    return _scaled("large_ball", 4.0)


def two_far_balls() -> RigidObject:
    """Two balls of radius 9 mm, 80 mm apart."""
    ball = _scaled("ball", 0.6)
    sides = [ball.vertices + np.array([x, 0.0, 0.0]) for x in (-0.040, 0.040)]
    triangles = np.concatenate([ball.triangles, ball.triangles + len(ball.vertices)])
    return RigidObject("two_far_balls", np.concatenate(sides), triangles)


def with_slivers(mesh: MembraneMesh, angle_rad: float, count: int = 12) -> MembraneMesh:
    """Mesh in which some nodes are moved to an opposite edge until an angle is as small as asked.

    Spread over the surface; the moved nodes leave it by no more than the facets do.
    """
    nodes = mesh.nodes.copy()
    taken = mesh.rim.copy()
    made = 0
    for i, j, k in mesh.triangles[:: max(1, len(mesh.triangles) // (4 * count))]:
        if made == count or taken[[i, j, k]].any():
            continue
        middle, half = 0.5 * (nodes[j] + nodes[k]), 0.5 * np.linalg.norm(nodes[k] - nodes[j])
        up = nodes[i] - middle
        nodes[i] = middle + up / np.linalg.norm(up) * half * np.tan(angle_rad)
        around = np.any(np.isin(mesh.triangles, [i, j, k]), axis=1)
        taken[mesh.triangles[around]] = True
        made += 1
    return MembraneMesh(nodes, mesh.triangles, mesh.rim)


def ply(nodes: np.ndarray, triangles: np.ndarray) -> bytes:
    """PLY file of a surface."""
    return ply_bytes(RigidObject("surface", nodes, triangles))


def only_pixels(count: int) -> Callable[[np.ndarray], np.ndarray]:
    """Keep `count` pixels, in the middle of the image and next to each other."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        kept = np.full_like(depth_m, np.nan)
        row, column = depth_m.shape[0] // 2, depth_m.shape[1] // 2
        kept[row, column : column + count] = depth_m[row, column : column + count]
        return kept

    return alter


def every(step: int) -> Callable[[np.ndarray], np.ndarray]:
    """Keep every `step`-th pixel of every `step`-th row."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        kept = np.full_like(depth_m, np.nan)
        kept[::step, ::step] = depth_m[::step, ::step]
        return kept

    return alter


def left_half(depth_m: np.ndarray) -> np.ndarray:
    """Without the right half of the image."""
    kept = depth_m.copy()
    kept[:, depth_m.shape[1] // 2 :] = np.nan
    return kept


def outliers(share: float, error_m: float) -> Callable[[np.ndarray], np.ndarray]:
    """Make a share of the pixels too far by the same error."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        wrong = np.random.default_rng(1).random(depth_m.shape) < share
        return np.where(wrong, depth_m + np.float32(error_m), depth_m)

    return alter


def read_only(depth_m: np.ndarray) -> np.ndarray:
    """Copy that cannot be written to."""
    kept = depth_m.copy()
    kept.flags.writeable = False
    return kept


def _stack(name: str, sections: list[tuple[float, float, float]]) -> RigidObject:
    """Rectangles of half widths x, y at heights z, joined."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
    return object_shapes._lathe(name, [(corners * [x, y], z) for x, y, z in sections])


def _scaled(name: str, factor: float) -> RigidObject:
    ball = sphere()
    return RigidObject(name, ball.vertices * factor, ball.triangles)
