"""The surface of a rigid object as a contact condition: distance and normal near any point."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.membrane.forward_model import is_watertight
from bubbleviz.membrane.mesh import MembraneMesh, area_vectors, cross, triangles_across
from bubbleviz.membrane.triangle_scene import TriangleScene
from bubbleviz.rigid_object import RigidObject

# Objects whose sharp edges are rounded: a core inside them and all that is within a radius of it.
#
# Nodes of a membrane cannot slide over a perfectly sharp edge. The triangle that spans it is kinked
# at one corner on either side, and the tensions of the two sides need not be equal however fine the
# mesh: the nodes catch on the edge as if there were friction. Over a rounding that is wider than
# their distance they slide.


_ALIKE = 0.01
"""Share of the largest eigenvalue below which normals at a vertex count as lying in a plane."""
_TRIES = 4  # times that a radius too large for an object's thinnest part or finest fillet is halved


def core_of(
    obj: RigidObject,  # watertight, counter-clockwise seen from outside
    radius_m: float,
) -> tuple[np.ndarray, float]:
    """Vertices (n, 3) of an object moved inward until its facets are a radius deeper, and that, m.

    Places at the radius from this core are on the object's faces, and on rounded edges between
    them. The radius is a fraction of the one given, or 0, where the core would turn inside out.
    """
    inward = _inward(obj)
    vectors = area_vectors(obj.vertices, obj.triangles)
    for _ in range(_TRIES):
        core = obj.vertices + radius_m * inward
        if (np.einsum("ij,ij->i", area_vectors(core, obj.triangles), vectors) > 0.0).all():
            return core, radius_m
        radius_m *= 0.5
    return obj.vertices, 0.0


def _inward(obj: RigidObject) -> np.ndarray:
    """Motion (n, 3) of the vertices, over the radius: all facets at a vertex go back by 1."""
    vectors = area_vectors(obj.vertices, obj.triangles)
    normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    squares = np.zeros((len(obj.vertices), 3, 3))
    sums = np.zeros_like(obj.vertices)
    for corner in obj.triangles.T:
        np.add.at(squares, corner, normals[:, :, None] * normals[:, None, :])
        np.add.at(sums, corner, normals)
    inverse = np.linalg.pinv(squares, rcond=_ALIKE, hermitian=True)
    moved: np.ndarray = -np.einsum("nij,nj->ni", inverse, sums)
    return moved


_SHARP, _FLAT = np.radians(30.0), np.radians(0.1)
"""Facets that meet at less than the first are taken as parts of one smooth surface, at less than
the second as parts of one face."""

MOST_TURN_RAD = 0.6
"""Turn of the object's normal along a triangle above which the triangle is too large to be taken as
a chord of a smooth surface."""

_ON_EDGE = 1e-5  # barycentric coordinate below which the closest point is on the edge of a facet
_LEAST_M = 1e-6  # distance of a point from a sharp edge above which its direction is known, m


class Planes(NamedTuple):
    """Half-spaces that points may not leave: n·(x + δ − x) ≥ −gap, one a point."""

    # (k,), signed distance, m, negative inside the object; inf where there is no condition
    gap: np.ndarray
    normal: np.ndarray  # (k, 3), unit, out of the object
    # (k, 3, 3), its derivative by the point, symmetric, 1/m: the curvature of the surface
    turn: np.ndarray

    @classmethod
    def nowhere(cls, count: int) -> Planes:
        """No condition on any of so many points."""
        return cls(np.full(count, np.inf), np.zeros((count, 3)), np.zeros((count, 3, 3)))

    def of(self, points: np.ndarray) -> Planes:
        """Conditions of some of the points."""
        return Planes(self.gap[points], self.normal[points], self.turn[points])


class ObjectSurface:
    """Closest places on an object's surface.

    Facets that meet at a blunt angle are parts of a smooth surface, whose normal is interpolated
    between their corners; others keep their edge, or are rounded. An object that is not watertight
    is a sheet, and presses from outside.
    """

    def __init__(
        self,
        obj: RigidObject,
        rounding_m: float = 0.0,  # radius of sharp edges; see `rounded_object`
    ) -> None:
        self.object = obj
        triangles, corners = obj.triangles, obj.vertices[obj.triangles]
        vectors = area_vectors(obj.vertices, triangles)
        self._solid = is_watertight(triangles)
        if self._solid and np.einsum("ij,ij->", vectors, corners[:, 0]) < 0.0:
            vectors = -vectors  # normals pointed inward: the signed volume was negative
            triangles = triangles[:, [0, 2, 1]]
        vertices, self._rounding_m = obj.vertices, 0.0
        if self._solid and rounding_m > 0.0:
            vertices, self._rounding_m = core_of(replace(obj, triangles=triangles), rounding_m)
        self._triangles, self._corners = triangles, vertices[triangles]
        self._facet_normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        self._corner_normals = self._smoothed(vectors)
        self._corner_slopes = _slopes(self._corners)
        self._side_bends, self._corner_bends = self._bends()
        self._scene = TriangleScene(vertices, triangles)
        self._centre = 0.5 * (obj.vertices.min(axis=0) + obj.vertices.max(axis=0))
        self._radius = float(np.linalg.norm(obj.vertices - self._centre, axis=1).max())

    def planes(
        self,
        # points, outward: (k, 3), in B: places on the membrane, m, and its unit normals there
        points: np.ndarray,
        outward: np.ndarray,
        T_B_O: np.ndarray,  # (4, 4)
        reach_m: float,  # points further from the object than this have no condition
    ) -> Planes:
        """Conditions on points near the object."""
        R = T_B_O[:3, :3]
        x, out = (points - T_B_O[:3, 3]) @ R, outward @ R
        gap, normal, turn = Planes.nowhere(len(x))
        near = np.flatnonzero(np.linalg.norm(x - self._centre, axis=1) < self._radius + reach_m)
        if len(near):
            gap[near], normal[near], turn[near] = self._near(x[near], out[near])
        gap[gap > reach_m] = np.inf
        return Planes(gap, normal @ R.T, R @ turn @ R.T)

    def turn_along(self, pressed: MembraneMesh, T_B_O: np.ndarray, reach_m: float) -> np.ndarray:
        """Largest turn of the object's normal along the sides of a pressed mesh's triangles, (m,).

        In rad; 0 where a corner is further from the object than the reach.
        """
        planes = self.planes(pressed.nodes, pressed.normals, T_B_O, reach_m)
        normals = planes.normal[pressed.triangles]
        cosine = np.einsum("tij,tij->ti", normals, np.roll(normals, -1, axis=1)).min(axis=1)
        near = np.isfinite(planes.gap)[pressed.triangles].all(axis=1)
        return np.where(near, np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0)

    def _near(self, x: np.ndarray, out: np.ndarray) -> Planes:
        _, facet, weights = self._scene.closest(x)
        away = x - np.einsum("ki,kij->kj", weights, self._corners[facet])
        normal = self._corner_normals[facet]
        turn = normal.swapaxes(1, 2) @ self._corner_slopes[facet]
        normal = np.einsum("ki,kij->kj", weights, normal)
        length = np.linalg.norm(normal, axis=1)
        normal /= length[:, None]
        turn = _across(normal, turn / length[:, None, None])
        gap = np.einsum("ij,ij->i", away, self._facet_normals[facet])
        aside = np.linalg.norm(away - gap[:, None] * self._facet_normals[facet], axis=1)
        beside = weights.min(axis=1) < _ON_EDGE
        # Nearest to a sharp edge or corner, not to the face it belongs to.
        edge = beside & (aside > np.maximum(0.5 * np.abs(gap), _LEAST_M))
        if not self._solid:
            behind = np.einsum("ij,ij->i", self._facet_normals[facet], out) > 0.0
            sign = np.where(behind, -1.0, 1.0)
            gap = np.where(edge, np.inf, sign * gap)
            return Planes(gap, sign[:, None] * normal, sign[:, None, None] * turn)
        found = Planes(gap, normal, turn)
        edge &= gap < 0.0
        self._round(found, np.flatnonzero(beside & (gap >= 0.0)), x, facet, weights)
        if edge.any():
            gap[edge] = np.where(self._scene.contains(x[edge]), -1.0, 1.0) * np.linalg.norm(
                away[edge], axis=1
            )
            normal[edge], turn[edge] = away[edge] / gap[edge, None], 0.0
        wrong = (gap < 0.0) & (np.einsum("ij,ij->i", normal, out) > 0.0)
        if wrong.any():
            gap[wrong], normal[wrong] = self._way_back(x[wrong], out[wrong])
            turn[wrong] = 0.0
        return found._replace(gap=gap - self._rounding_m)

    def _round(
        self, found: Planes, some: np.ndarray, x: np.ndarray, facet: np.ndarray, weights: np.ndarray
    ) -> None:
        """Distances of points outside that are nearest to a side of a facet and not to its plane.

        Where that is sharp, normals go round it; elsewhere they stay those of a smooth surface.
        """
        facets, side = facet[some], weights[some].argmin(axis=1)
        start = self._corners[facets, (side + 1) % 3]
        along = self._corners[facets, (side + 2) % 3] - start
        length = np.linalg.norm(along, axis=1)
        along /= length[:, None]
        from_start = x[some] - start
        way = np.einsum("ij,ij->i", from_start, along)
        outside = np.einsum("ij,ij->i", from_start, cross(along, self._facet_normals[facets])) > 0.0
        between = (way > 0.0) & (way < length)
        corner = (side + np.where(way > 0.0, 2, 1)) % 3
        bend = np.where(between, self._side_bends[facets, side], self._corner_bends[facets, corner])
        kept = (outside | ~between) & (bend > _FLAT)
        away = from_start - np.clip(way, 0.0, length)[:, None] * along
        distance = np.linalg.norm(away, axis=1)
        found.gap[some[kept]] = distance[kept]
        kept &= (bend > _SHARP) & (distance > max(0.1 * self._rounding_m, _LEAST_M))
        some, normal = some[kept], away[kept] / distance[kept, None]
        plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        line = np.where(between[kept, None], along[kept], 0.0)
        plane -= line[:, :, None] * line[:, None, :]
        found.normal[some], found.turn[some] = normal, 0.0
        if self._rounding_m > 0.0:
            found.turn[some] = plane / distance[kept, None, None]

    def _bends(self) -> tuple[np.ndarray, np.ndarray]:
        """Angles between facets, (m, 3), rad: across the side opposite each corner, at it."""
        triangles = self._triangles
        across = triangles_across(triangles)
        dots = np.einsum("ij,ikj->ik", self._facet_normals, self._facet_normals[across])
        sides = np.where(across >= 0, np.arccos(np.clip(dots, -1.0, 1.0)), 0.0)
        vertices = np.zeros(int(triangles.max()) + 1)
        for k in range(3):
            for end in (1, 2):
                np.maximum.at(vertices, triangles[:, (k + end) % 3], sides[:, k])
        return sides, vertices[triangles]

    def _way_back(self, x: np.ndarray, out: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Conditions of points nearest to the far side of a thin object: back the way they came."""
        facet, distance = self._scene.cast(np.hstack([x, -out]))
        met = np.isfinite(distance)
        facet[~met] = 0
        normal = self._facet_normals[facet]
        gap = np.einsum("ij,ij->i", x - self._corners[facet, 0], normal)
        return np.where(met & (gap < 0.0), gap, np.inf), normal

    def _smoothed(self, vectors: np.ndarray) -> np.ndarray:
        """Unit normals (m, 3, 3) at the facets' corners: means over facets of the same surface."""
        triangles = self._triangles
        count, n = len(triangles), int(triangles.max()) + 1
        facets = np.repeat(np.arange(count), 3)
        ones = np.ones(3 * count)
        at = sparse.csr_array((ones, (np.arange(3 * count), triangles.ravel())), (3 * count, n))
        of = sparse.csr_array((ones, (triangles.ravel(), facets)), (n, count))
        pairs = (at @ of).tocoo()
        corner, other = pairs.coords
        dots = np.einsum("ij,ij->i", self._facet_normals[corner // 3], self._facet_normals[other])
        kept = dots > np.cos(_SHARP)
        sums = np.stack(
            [
                np.bincount(corner[kept], vectors[other[kept], i], minlength=3 * count)
                for i in range(3)
            ],
            axis=1,
        )
        return (sums / np.linalg.norm(sums, axis=1, keepdims=True)).reshape(count, 3, 3)


def _across(normal: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Symmetric part of `turn` (k, 3, 3) in the planes across unit normals (k, 3)."""
    plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    return plane @ (0.5 * (turn + turn.swapaxes(1, 2))) @ plane


def _slopes(corners: np.ndarray) -> np.ndarray:
    """Gradients (m, 3, 3) of the barycentric coordinates in facets with corners (m, 3, 3), 1/m."""
    sides = [corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3] for k in range(3)]
    vector = cross(sides[0], sides[1])
    square = np.einsum("ij,ij->i", vector, vector)[:, None, None]
    return np.stack([cross(vector, side) for side in sides], axis=1) / square
