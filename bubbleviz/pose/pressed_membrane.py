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
from scipy.linalg import cho_factor, cho_solve

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.inverse.problem import Equilibrium
from bubbleviz.inverse.scales import Scales
from bubbleviz.inverse.solvers.pivoting import DenseQuadratic, nonnegative_qp
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh, cross, triangles_across
from bubbleviz.pose.contact_points import ContactPoints
from bubbleviz.pose.contact_samples import contact_samples
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.rigid_motion import moved, rows

_SOFT = 2e-3
"""Softness of the object in units of the membrane's: many points on one triangle share its load."""

_GAP_M = 5e-4
"""Points further above the membrane at rest cannot be touched."""

_SIDEWAYS = 0.1
"""Cosine of a point's normal with the membrane's beyond which it looks away from it."""

_OFF = -0.05
"""Barycentric coordinate of a point that is not over the membrane, but beyond its rim."""

_STEPS = 6
_TOLERANCE = 1e-3
"""Steps to the place below a point, and what they may leave in units of a triangle."""

AROUND_M = 5e-3
"""How far around the patch an object's outline shows: the membrane smooths out what is further."""

_MARGIN_EDGES = 2.0
"""How much further responses are kept at hand, in edges: the contact moves."""

_MOST_ROWS = 2_500
"""Responses that are kept in all."""


@dataclass(frozen=True)
class _Projection:
    """Where points are over the membrane at rest.

    Attributes
    ----------
    triangle : (c,) int array
        The one below each.
    corners : (c, 3) int array
        Its nodes.
    weights : (c, 3) array
        Barycentric coordinates there.
    height_m : (c,) array
        Along the interpolated normals, positive outside.
    """

    triangle: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    height_m: np.ndarray

    def of(self, some: np.ndarray | slice) -> _Projection:
        """Of some of the points."""
        return _Projection(
            self.triangle[some], self.corners[some], self.weights[some], self.height_m[some]
        )


@dataclass(frozen=True)
class _Responses:
    """What forces on the nodes below an object do to the membrane around it.

    Attributes
    ----------
    number : (n,) int array
        Place of each node among those that may carry forces, −1 for others.
    own : (l, l) array
        Displacement of these under a unit force inward on each.
    around : (k,) int array
        The nodes around the contact.
    M : (k, l) array
        Their displacement.
    """

    number: np.ndarray
    own: np.ndarray
    around: np.ndarray
    M: np.ndarray

    def between(self, projection: _Projection) -> np.ndarray:
        """Displacement (c, c) of points under forces on each other, slightly softened."""
        corners, weights = self.number[projection.corners], projection.weights
        half = np.einsum("ca,caj->cj", weights, self.own[corners])
        C = np.einsum("ca,jca->jc", weights, half[:, corners])
        diagonal = np.arange(len(C))
        C[diagonal, diagonal] *= 1.0 + _SOFT
        return C

    def reach(self, projection: _Projection) -> np.ndarray:
        """Which points (c,) are over nodes that may carry forces."""
        over: np.ndarray = np.all(self.number[projection.corners] >= 0, axis=1)
        return over

    def loads(self, projection: _Projection, forces: np.ndarray) -> np.ndarray:
        """Forces (c,) on points, on the nodes (l,) below them."""
        shares = (projection.weights * forces[:, None]).ravel()
        corners = self.number[projection.corners].ravel()
        return np.bincount(corners, shares, minlength=len(self.own))

    def displacements(self, loads: np.ndarray) -> np.ndarray:
        """Displacements (n, s) around the contact under loads (l, s), 0 elsewhere."""
        u = np.zeros((len(self.number), loads.shape[1]))
        u[self.around] = -self.M @ loads
        return u


@dataclass(frozen=True)
class Press:
    """An object pressed into the membrane.

    Attributes
    ----------
    displacement_m : (n,) array
        u around the contact, 0 far from it.
    points : (c, 3) array
        Places of the object that touch, in B.
    held : _Projection
        Where they are over the membrane.
    responses : _Responses
    factor : tuple
        Cholesky factor of their responses to each other.
    """

    displacement_m: np.ndarray
    points: np.ndarray
    held: _Projection
    responses: _Responses
    factor: tuple[np.ndarray, bool]


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
        self.mesh = mesh
        self._equilibrium = Equilibrium(mesh, gas, scales)
        self._points, self._normals = contact_samples(model, mesh.edge_length)
        self._scene = TriangleScene(mesh.nodes, mesh.triangles)
        self._neighbours = triangles_across(mesh.triangles)
        self._row = np.full(len(mesh.nodes), -1)
        self._compliance = np.zeros((0, len(mesh.nodes)), np.float32)
        nobody, none = np.zeros(0, int), np.zeros((0, 0))
        self._responses = _Responses(self._row.copy(), none, nobody, none)
        self._triangle = np.full(len(self._points), -1)
        self._touching = np.zeros(len(self._points), bool)

    def press(self, T_B_O: np.ndarray, contact: ContactPoints) -> Press:
        """Press the object at a pose (4, 4); only the part of it that is near the contact."""
        near, projection = self._candidates(T_B_O, contact)
        responses = self._around(projection, contact)
        C = responses.between(projection)
        start = self._touching[near]
        guess = start if start.any() else projection.height_m < 0.0
        forces, _, _ = nonnegative_qp(DenseQuadratic(C), projection.height_m, guess, 1e-6)
        touching = np.flatnonzero(forces > 0.0)
        self._touching[:] = False
        self._touching[near[touching]] = True
        held = projection.of(touching)
        loads = responses.loads(held, forces[touching])
        return Press(
            displacement_m=responses.displacements(loads[:, None])[:, 0],
            points=self._points[near[touching]] @ T_B_O[:3, :3].T + T_B_O[:3, 3],
            held=held,
            responses=responses,
            factor=cho_factor(C[np.ix_(touching, touching)], check_finite=False),
        )

    def lifted(self, press: Press, motions: np.ndarray, center: np.ndarray) -> np.ndarray:
        """Derivatives (n, q) of u by motions (6, q) in B about a centre, by their heights alone."""
        held = press.held
        normals = np.einsum("ca,cak->ck", held.weights, self.mesh.normals[held.corners])
        heights = rows(normals, press.points, center) @ motions
        forces = -cho_solve(press.factor, heights, check_finite=False)
        loads = np.empty((len(press.responses.own), motions.shape[1]))
        for k, force in enumerate(forces.T):
            loads[:, k] = press.responses.loads(held, force)
        return press.responses.displacements(loads)

    def slid(self, press: Press, motions: np.ndarray, center: np.ndarray) -> np.ndarray:
        """Displacements (n, s) after motions (s, 6) in B about a centre; what touches stays so."""
        T = np.stack([moved(np.eye(4), motion, center) for motion in motions])
        points = np.einsum("sij,cj->sci", T[:, :3, :3], press.points) + T[:, None, :3, 3]
        count = len(press.points)
        start = press.held.of(np.tile(np.arange(count), len(motions)))
        projection = self._project(points.reshape(-1, 3), start)
        loads = np.empty((len(press.responses.own), len(motions)))
        for k in range(len(motions)):
            there = projection.of(slice(k * count, (k + 1) * count))
            there = there.of(press.responses.reach(there))
            factor = cho_factor(press.responses.between(there), check_finite=False)
            forces = -cho_solve(factor, there.height_m, check_finite=False)
            loads[:, k] = press.responses.loads(there, forces)
        return press.responses.displacements(loads)

    def _candidates(
        self, T_B_O: np.ndarray, contact: ContactPoints
    ) -> tuple[np.ndarray, _Projection]:
        """Object points (c,) that the membrane may touch at a pose, and where they are."""
        R, t = T_B_O[:3, :3], T_B_O[:3, 3]
        reach = contact.extent_m + AROUND_M
        away = np.sum((self._points - (contact.center - t) @ R) ** 2, axis=1)
        near = np.flatnonzero(away < reach**2)
        points = self._points[near] @ R.T + t
        new = self._triangle[near] < 0
        self._triangle[near[new]] = self._closest(points[new])
        projection = self._project(points, self._unknown(self._triangle[near]))
        over = projection.weights.min(axis=1) > _OFF
        self._triangle[near] = np.where(over, projection.triangle, -1)
        normals = self.mesh.normals[projection.corners].mean(axis=1)
        looks = np.einsum("cij,cj->ci", self._normals[near] @ R.T, normals)
        kept = over & (projection.height_m < _GAP_M) & (looks.min(axis=1) < _SIDEWAYS)
        return near[kept], projection.of(kept)

    def _around(self, projection: _Projection, contact: ContactPoints) -> _Responses:
        """Responses to forces below the object, of all nodes that a camera sees around it."""
        away = np.linalg.norm(self.mesh.nodes - contact.rest_center, axis=1)
        reach = contact.extent_m + AROUND_M + 2.0 * self.mesh.edge_length
        carrying = np.zeros(len(self.mesh.nodes), bool)
        carrying[projection.corners] = True
        carrying = self._grown(carrying)  # points move on to the next triangle
        known, seen = self._responses, np.zeros(len(self.mesh.nodes), bool)
        seen[known.around] = True
        if np.all(known.number[carrying] >= 0) and np.all(seen[away < reach]):
            return known
        carrying = self._grown(carrying)
        wide = carrying | (away < reach + _MARGIN_EDGES * self.mesh.edge_length)
        loaded, around = np.flatnonzero(carrying), np.flatnonzero(wide)
        rows = self._compliances(loaded)
        number = np.full(len(self.mesh.nodes), -1)
        number[loaded] = np.arange(len(loaded))
        own, M = rows[:, loaded].astype(np.float64), rows[:, around].T.astype(np.float64)
        self._responses = _Responses(number, own, around, M)
        return self._responses

    def _grown(self, nodes: np.ndarray) -> np.ndarray:
        """Some nodes (n,) bool and all that share a triangle with them."""
        grown = nodes.copy()
        grown[self.mesh.triangles[nodes[self.mesh.triangles].any(axis=1)]] = True
        return grown

    def _compliances(self, nodes: np.ndarray) -> np.ndarray:
        """Displacements (l, n) under a unit force inward on each of some nodes; 0 on the rim."""
        new = nodes[self._row[nodes] < 0]
        if len(self._compliance) + len(new) > _MOST_ROWS:
            self._row[:] = -1
            self._compliance, new = self._compliance[:0], nodes
        free = self.mesh.free
        own = np.searchsorted(free, new)
        own[self.mesh.rim[new]] = -1
        loads = np.zeros((len(free), len(new)))
        moves = np.flatnonzero(own >= 0)
        loads[own[moves], moves] = 1.0 / self._equilibrium.A[own[moves]]
        found = np.zeros((len(new), len(self.mesh.nodes)), np.float32)
        found[:, free] = self._equilibrium.response(loads).T
        self._row[new] = len(self._compliance) + np.arange(len(new))
        self._compliance = np.concatenate([self._compliance, found])
        return self._compliance[self._row[nodes]]

    def _closest(self, points: np.ndarray) -> np.ndarray:
        """Triangle (k,) of the membrane at rest that is closest to each point (k, 3)."""
        return self._scene.closest(points).triangle if len(points) else np.zeros(0, np.int64)

    def _unknown(self, triangle: np.ndarray) -> _Projection:
        """A first guess above the middle of triangles (c,)."""
        corners = self.mesh.triangles[triangle]
        return _Projection(
            triangle, corners, np.full(corners.shape, 1.0 / 3.0), np.zeros(len(corners))
        )

    def _project(self, points: np.ndarray, start: _Projection) -> _Projection:
        """Barycentric coordinates and height of points (c, 3), walking from a place close by.

        Newton's method on the triangle, and on to the neighbour where it leads out of it.
        """
        triangle, weights, height = (
            start.triangle.copy(),
            start.weights.copy(),
            start.height_m.copy(),
        )
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
        return _Projection(triangle, self.mesh.triangles[triangle], weights, height)


def _solve3(a: np.ndarray, b: np.ndarray, c: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions (k, 3) of [a b c] x = right by Cramer's rule."""
    bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
    volume = np.einsum("ij,ij->i", a, bc)
    parts = [np.einsum("ij,ij->i", right, side) for side in (bc, ca, ab)]
    return np.stack(parts, axis=1) / volume[:, None]
