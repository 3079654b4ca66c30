"""Extreme objects, meshes and images for the stability study."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from trimesh.convex import convex_hull

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.rigid_object import RigidObject
from bubbleviz.simulation.presses import made
from bubbleviz.study.stability_trial import Alter


def _stack(name: str, sections: list[tuple[float, float, float]]) -> RigidObject:
    """Rectangles of half widths x, y at heights z, joined."""
    signs = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float)
    hull = convex_hull(np.concatenate([signs * section for section in sections]))
    return RigidObject(name, np.array(hull.vertices), np.array(hull.faces, np.int64))


def _ball(name: str, radius_m: float) -> RigidObject:
    ball = made("sphere")
    return RigidObject(name, ball.vertices * (radius_m / 0.015), ball.triangles)


# Cone of 2 mm radius and 30 mm length with a tip of 0.05 mm; blade 0.2 mm thick; plate wider than
# the sensor; ball that is wholly inside the dome when pressed deep enough; ball larger than it
needle = partial(_stack, "needle", [(5e-5, 5e-5, 0.0), (2e-3, 2e-3, 0.030)])
blade = partial(_stack, "blade", [(0.020, 1e-4, 0.0), (0.020, 1e-4, 0.020)])
plate = partial(_stack, "plate", [(0.15, 0.15, 0.0), (0.15, 0.15, 0.005)])
pellet = partial(_ball, "pellet", 0.004)
large_ball = partial(_ball, "large_ball", 0.060)


def two_far_balls() -> RigidObject:
    """Two balls of radius 9 mm, 80 mm apart."""
    ball = _ball("ball", 0.009)
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


def _only(depth_m: np.ndarray, where: Any) -> np.ndarray:
    kept = np.full_like(depth_m, np.nan)
    kept[where] = depth_m[where]
    return kept


def only_pixels(count: int) -> Alter:
    """Keep `count` pixels, in the middle of the image and next to each other."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        row, column = depth_m.shape[0] // 2, depth_m.shape[1] // 2
        return _only(depth_m, np.s_[row, column : column + count])

    return alter


def every(step: int) -> Alter:
    """Keep every `step`-th pixel of every `step`-th row."""
    return lambda depth_m: _only(depth_m, np.s_[::step, ::step])


def left_half(depth_m: np.ndarray) -> np.ndarray:
    """Without the right half of the image."""
    return _only(depth_m, np.s_[:, : depth_m.shape[1] // 2])


def outliers(share: float, error_m: float) -> Alter:
    """Make a share of the pixels too far by the same error."""

    def alter(depth_m: np.ndarray) -> np.ndarray:
        wrong = np.random.default_rng(1).random(depth_m.shape) < share
        return np.where(wrong, depth_m + np.float32(error_m), depth_m)

    return alter
