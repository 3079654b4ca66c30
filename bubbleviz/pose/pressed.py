"""The membrane that an object at a pose would make.

Eqs. 10 to 16, written for points of the object in place of nodes of the membrane: below the
object's point j, at barycentric coordinates b on the reference surface, the membrane may move
outward by h_j and no more. With u = −M Bᵀf for forces f on those points (Eq. 24, gas law in M),

    f ≥ 0,   h − B u ≥ 0,   fᵀ(h − B u) = 0.

Moving the object changes h and B smoothly, so that the membrane's shape follows the pose even
where a flat face slides in its own plane: its edges move over the membrane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.inverse.pivoting import DenseQuadratic, nonnegative_qp
from bubbleviz.inverse.problem import Equilibrium
from bubbleviz.inverse.scales import Scales
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh, triangles_across
from bubbleviz.pose.contact import ContactPoints
from bubbleviz.pose.model import ObjectModel
from bubbleviz.pose.samples import contact_samples

_SOFT = 2e-3
"""Softness of the object in units of the membrane's: many points on one triangle share its load."""

_GAP_M = 5e-4
"""Points further above the membrane at rest cannot be touched."""

_CLOSE_M = 2e-3
"""Way of a point to the membrane that a small motion of the object may close."""

_SIDEWAYS = 0.1
"""Cosine of a point's normal with the membrane's beyond which it looks away from it."""

_REACH_M = 0.015
_STEPS = 6
_TOLERANCE = 1e-3
"""Steps to the place below a point, and what they may leave in units of a triangle."""


@dataclass(frozen=True)
class _Below:
    """Where points are over the membrane at rest.

    Attributes
    ----------
    corners : (k, 3) int array
        Nodes of the triangle below each.
    weights : (k, 3) array
        Barycentric coordinates there.
    height_m : (k,) array
        Along the interpolated normals, positive outside.
    """

    corners: np.ndarray
    weights: np.ndarray
    height_m: np.ndarray


class PressedMembrane:
    """Presses one object into a membrane, pose after pose.

    Parameters
    ----------
    mesh : MembraneMesh
    gas : Gas
    scales : Scales
    model : ObjectModel
    """

    def __init__(self, mesh: MembraneMesh, gas: Gas, scales: Scales, model: ObjectModel) -> None:
        from open3d import core
        from open3d.t.geometry import RaycastingScene

        self.mesh = mesh
        self._equilibrium = Equilibrium(mesh, gas, scales)
        self._points, self._normals = contact_samples(model, mesh.edge_length)
        self._scene = RaycastingScene()
        self._scene.add_triangles(
            core.Tensor.from_numpy(mesh.nodes.astype(np.float32)),
            core.Tensor.from_numpy(np.ascontiguousarray(mesh.triangles, np.uint32)),
        )
        self._neighbours = triangles_across(mesh.triangles)
        self._row = np.full(len(mesh.nodes), -1)
        self._compliance = np.zeros((0, len(mesh.nodes)))
        self._touching = np.zeros(len(self._points), bool)

    def press(self, poses: np.ndarray, contact: ContactPoints) -> np.ndarray:
        """Displacements (s, n) in m of the membrane under the object at poses T_B_O (s, 4, 4).

        The poses are close to the first. Only the part of the object that is near the contact is
        pressed, and only what nearly touches at the first pose may touch at the others.
        """
        displacement = np.zeros((len(poses), len(self.mesh.nodes)))
        near, triangle, below = self._candidates(poses[0], contact)
        if not len(near):
            return displacement
        start = self._touching[near]
        (displacement[0],), touching = self._pressed(below, 1, start)
        self._touching[:] = False
        self._touching[near] = touching
        up = np.einsum("ij,ij->i", below.weights, displacement[0][below.corners])
        kept = below.height_m - up < _CLOSE_M
        if len(poses) > 1 and kept.any():
            R, t = poses[1:, :3, :3], poses[1:, None, :3, 3]
            points = np.einsum("sij,pj->spi", R, self._points[near[kept]]) + t
            others = self._below(points.reshape(-1, 3), np.tile(triangle[kept], len(poses) - 1))
            displacement[1:], _ = self._pressed(others, len(poses) - 1, touching[kept])
        return displacement

    def _pressed(
        self, below: _Below, poses: int, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (s, n) under points of several poses, and which touch at the last one."""
        nodes, local = np.unique(below.corners, return_inverse=True)
        rows = self._responses(nodes)
        M = rows[:, nodes]
        corners = local.reshape(poses, -1, 3)
        weights = below.weights.reshape(poses, -1, 3)
        heights = below.height_m.reshape(poses, -1)
        loads = np.zeros((poses, len(nodes)))
        for k in range(poses):
            f = _contact_forces(M, corners[k], weights[k], heights[k], start)
            shares = (weights[k] * f[:, None]).ravel()
            loads[k] = np.bincount(corners[k].ravel(), shares, minlength=len(nodes))
        return -loads @ rows, f > 0.0

    def _candidates(
        self, T_B_O: np.ndarray, contact: ContactPoints
    ) -> tuple[np.ndarray, np.ndarray, _Below]:
        """Object points (c,) that the membrane may touch at a pose, and where they are."""
        R, t = T_B_O[:3, :3], T_B_O[:3, 3]
        reach = 2.0 * contact.radius_m + _REACH_M
        away = np.sum((self._points - (contact.center - t) @ R) ** 2, axis=1)
        near = np.flatnonzero(away < reach**2)
        points = self._points[near] @ R.T + t
        triangle = self._closest(points)
        below = self._below(points, triangle)
        normals = self.mesh.normals[below.corners].mean(axis=1)
        looks = np.einsum("pij,pj->pi", self._normals[near] @ R.T, normals)
        kept = (below.height_m < _GAP_M) & (looks.min(axis=1) < _SIDEWAYS)
        kept &= below.weights.min(axis=1) > -0.05  # not beyond the rim
        found = _Below(below.corners[kept], below.weights[kept], below.height_m[kept])
        return near[kept], triangle[kept], found

    def _closest(self, points: np.ndarray) -> np.ndarray:
        """Triangle (k,) of the membrane at rest that is closest to each point (k, 3)."""
        from open3d import core

        query = core.Tensor.from_numpy(np.ascontiguousarray(points, np.float32))
        found = self._scene.compute_closest_points(query)["primitive_ids"]
        return found.numpy().astype(np.int64)

    def _below(self, points: np.ndarray, triangle: np.ndarray) -> _Below:
        """Barycentric coordinates and height of points (k, 3), walking from a triangle close by.

        Newton's method on the triangle, and on to the neighbour where it leads out of it.
        """
        triangle = triangle.copy()
        weights = np.full((len(points), 3), 1.0 / 3.0)
        height = np.zeros(len(points))
        moving = np.arange(len(points))
        for step in range(_STEPS):
            corners = self.mesh.triangles[triangle[moving]]
            w, h = weights[moving], height[moving]
            normals = self.mesh.normals[corners]
            lifted = self.mesh.nodes[corners] + h[:, None, None] * normals
            miss = points[moving] - np.einsum("ij,ijk->ik", w, lifted)
            up = np.einsum("ij,ijk->ik", w, normals)
            change = _solve3(lifted[:, 0] - lifted[:, 2], lifted[:, 1] - lifted[:, 2], up, miss)
            w[:, :2] += change[:, :2]
            w[:, 2] = 1.0 - w[:, 0] - w[:, 1]
            weights[moving], height[moving] = w, h + change[:, 2]
            if step == _STEPS - 1:
                break
            out = np.argmin(w, axis=1)
            following = self._neighbours[triangle[moving], out]
            leaves = (w.min(axis=1) < -_TOLERANCE) & (following >= 0)
            walking = moving[leaves]
            triangle[walking] = following[leaves]
            weights[walking] = 1.0 / 3.0
            moving = moving[leaves | (np.abs(change[:, 2]) > _TOLERANCE * self.mesh.edge_length)]
            if not len(moving):
                break
        return _Below(self.mesh.triangles[triangle], weights, height)

    def _responses(self, nodes: np.ndarray) -> np.ndarray:
        """Displacement (k, n) under a unit force into the bubble on each node; 0 for the rim's."""
        new = nodes[self._row[nodes] < 0]
        if len(new):
            free = self.mesh.free
            number = np.full(len(self.mesh.nodes), -1)
            number[free] = np.arange(len(free))
            own = number[new]
            loads = np.zeros((len(free), len(new)))
            moves = own >= 0
            loads[own[moves], np.flatnonzero(moves)] = 1.0 / self._equilibrium.A[own[moves]]
            rows = np.zeros((len(new), len(self.mesh.nodes)))
            rows[:, free] = self._equilibrium.response(loads).T
            self._row[new] = len(self._compliance) + np.arange(len(new))
            self._compliance = np.concatenate([self._compliance, rows])
        return self._compliance[self._row[nodes]]


def _contact_forces(
    M: np.ndarray, corners: np.ndarray, weights: np.ndarray, height_m: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Forces f ≥ 0 (c,) on points that may not be inside the object; see the module."""
    BM = np.zeros((len(corners), len(M)))
    C = np.zeros((len(corners), len(corners)))
    for a in range(3):
        BM += weights[:, a, None] * M[corners[:, a]]
    for a in range(3):
        C += weights[:, a] * BM[:, corners[:, a]]
    diagonal = np.arange(len(C))
    C[diagonal, diagonal] += _SOFT * C[diagonal, diagonal].mean()
    guess = start if start.any() else height_m < 0.0
    forces, _, _ = nonnegative_qp(DenseQuadratic(C), height_m, guess, 1e-6)
    return forces


def _solve3(a: np.ndarray, b: np.ndarray, c: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions (k, 3) of [a b c] x = right by Cramer's rule."""
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    volume = np.einsum("ij,ij->i", a, bc)
    parts = [np.einsum("ij,ij->i", right, side) for side in (bc, ca, ab)]
    return np.stack(parts, axis=1) / volume[:, None]
