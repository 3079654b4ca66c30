"""Surface of a rigid object: distance, normal and edges near any point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh, area_vectors, cross, triangles_across
from bubbleviz.membrane.triangle_scene import TriangleScene
from bubbleviz.rigid_object import RigidObject

# Objects with rounded edges: all points within a radius of a core inside the object.
#
# Nodes of a membrane cannot slide over a perfectly sharp edge: at any mesh size the tensions on
# both sides of a triangle that spans it may differ, as if there were friction. Nodes slide over a
# rounding that is wider than their distance.


_COPLANAR = 0.01
"""Share of the largest eigenvalue below which normals at a vertex count as coplanar."""
_PAIRS = 1 << 18  # of facets at a vertex that are compared at a time
_TRIES = 10  # times that a radius too large for a thin part or a fine fillet is halved


def core_of(
    obj: RigidObject,  # watertight, counter-clockwise seen from outside
    radii: np.ndarray,  # (n,), at the vertices, m
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) of an object moved inward until its facets are a radius deeper, and radii, m.

    Places at the radius from this core are on the object's faces, and on rounded edges between
    them. Where facets of the core would turn inside out, the radius (n,) is a fraction of the one
    given; facets between vertices of different radii are deeper by what is between these.
    """
    inward, radii = _inward(obj), radii.copy()
    vectors = area_vectors(obj.vertices, obj.triangles)
    for _ in range(_TRIES):
        core = obj.vertices + radii[:, None] * inward
        kept = np.einsum("ij,ij->i", area_vectors(core, obj.triangles), vectors) > 0.0
        if kept.all():
            return core, radii
        radii[np.unique(obj.triangles[~kept])] *= 0.5
    return obj.vertices, np.zeros(len(radii))


def _inward(obj: RigidObject) -> np.ndarray:
    """Motion (n, 3) of the vertices over the radius: all facets at a vertex recede by 1."""
    vectors = area_vectors(obj.vertices, obj.triangles)
    normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    squares = np.zeros((len(obj.vertices), 3, 3))
    sums = np.zeros_like(obj.vertices)
    for corner in obj.triangles.T:
        np.add.at(squares, corner, normals[:, :, None] * normals[:, None, :])
        np.add.at(sums, corner, normals)
    inverse = np.linalg.pinv(squares, rcond=_COPLANAR, hermitian=True)
    moved: np.ndarray = -np.einsum("nij,nj->ni", inverse, sums)
    return moved


CREASE_RAD = np.radians(20.0)
"""Least angle between facets at an edge of the object (smaller ones approximate curved surfaces): a
circle of 20 facets still counts as round."""
_FLAT = np.radians(0.1)  # facets that meet at less are parts of one face
_STEP = 0.01  # distance of points along creases over the object's size

MOST_TURN_RAD = 0.6
"""Largest turn of the object's normal along a triangle that approximates a smooth surface."""

_ON_EDGE = 1e-5  # barycentric coordinate below which the closest point is on the edge of a facet
_TURNED_POINTS, _TURNED_STEPS = 200, 6  # of a turned object that is registered to itself; chosen
_SPIN = 0.1
"""Singular value over the largest, below which a rotation moves only the facets of a round object,
not its surface: their normals are up to 5° off if 36 go round. Of study objects, the round ones are
below 0.01, the others above 0.3."""
_LEAST_M = 1e-6  # distance of a point from a sharp edge above which its direction is known, m


class Planes(NamedTuple):
    """Half-space constraints of points, one per point: n·δ ≥ −gap."""

    # (k,), signed distance, m, negative inside the object; inf without a constraint
    gap: np.ndarray
    normal: np.ndarray  # (k, 3), unit, out of the object
    # (k, 3, 3), its derivative by the point, symmetric, 1/m: the curvature of the surface
    turn: np.ndarray

    @classmethod
    def nowhere(cls, count: int) -> Planes:
        """No constraints, for a number of points."""
        return cls(np.full(count, np.inf), np.zeros((count, 3)), np.zeros((count, 3, 3)))

    def of(self, points: np.ndarray) -> Planes:
        """Constraints of some of the points."""
        return Planes(self.gap[points], self.normal[points], self.turn[points])


class Closest(NamedTuple):
    """Closest points of an object, in O."""

    place: np.ndarray  # (k, 3)
    normal: np.ndarray  # (k, 3), outward, smooth but across creases


@dataclass(frozen=True)
class Creases:
    """Points along the convex edges of an object, in O."""

    tree: Any  # of the points (c, 3)
    normals: np.ndarray  # (c, 2, 3), of the two faces that meet there, smooth along them


class ObjectSurface:
    """Surface of a rigid object: distances, closest places, crossings, edges, samples.

    Facets that meet at a blunt angle are parts of a smooth surface, whose normal is interpolated
    between their corners; others keep their edge, or are rounded. An object that is not watertight
    is a sheet, and presses from outside. Facets without area are left out.

    Raises InputError: the mesh has no area.
    """

    def __init__(
        self,
        obj: RigidObject,
        # radii of rounding, m, of all edges and of those that turn by more than MOST_TURN_RAD, if
        # that is larger; smaller where `core_of` says
        rounding_m: float = 0.0,
        sharp_m: float = 0.0,
    ) -> None:
        self.obj, self.size_m = obj, float(np.ptp(obj.vertices, axis=0).max())
        vectors = area_vectors(obj.vertices, obj.triangles)
        areas = np.linalg.norm(vectors, axis=1)
        self.area_m2 = float(areas.sum())
        if not self.area_m2 > 1e-8 * self.size_m**2:
            raise InputError(f"object {obj.name}: its triangles have no area; export a surface")
        self.solid = _is_watertight(obj.triangles)
        kept = areas > 1e-12 * self.size_m**2
        triangles, vectors, self.facet_areas = obj.triangles[kept], vectors[kept], areas[kept]
        corners = obj.vertices[triangles[:, 0]]
        if self.solid and np.einsum("ij,ij->", vectors, corners) < 0.0:
            vectors = -vectors  # normals pointed inward: the signed volume was negative
            triangles = triangles[:, [0, 2, 1]]
        self.triangles, self._vectors = triangles, vectors
        self.facet_normals = vectors / self.facet_areas[:, None]
        vertices, rounding = obj.vertices, np.zeros(len(obj.vertices))
        if self.solid and rounding_m > 0.0:
            rounding += rounding_m
            sharp = triangles[self._bends[1] > MOST_TURN_RAD]
            rounding[sharp] = max(rounding_m, sharp_m)
            vertices, rounding = core_of(replace(obj, triangles=triangles), rounding)
        self._corners = vertices[triangles]
        self._rounding_m = rounding[triangles]  # at the corners of each facet
        self._corner_normals = self._smoothed()
        self._scene = TriangleScene(vertices, triangles)
        self._centre = 0.5 * (obj.vertices.min(axis=0) + obj.vertices.max(axis=0))
        self._radius = float(np.linalg.norm(obj.vertices - self._centre, axis=1).max())

    def closest(self, points: np.ndarray) -> Closest:
        """Closest places to points (k, 3) in O."""
        place, facet, weights = self._scene.closest(points)
        normal = np.einsum("ki,kij->kj", weights, self._corner_normals[facet])
        return Closest(place, normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def sample(self, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 3) spread evenly over the surface, and their smooth normals, in O."""
        random = np.random.default_rng(seed)
        shares = self.facet_areas / self.facet_areas.sum()
        facet = random.choice(len(shares), count, p=shares)
        a, b = random.random((2, count))
        a, b = np.where(a + b > 1.0, 1.0 - a, a), np.where(a + b > 1.0, 1.0 - b, b)
        weights = np.column_stack([1.0 - a - b, a, b])
        normals = np.einsum("ij,ijk->ik", weights, self._corner_normals[facet])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return np.einsum("ij,ijk->ik", weights, self._corners[facet]), normals

    def nearest_symmetry(
        self,
        turn: np.ndarray,
        # distance over the object's size below which its turned surface is the same; chosen
        tolerance: float = 2e-3,
        within_rad: float = np.pi,  # largest angle between the turn and that rotation
    ) -> np.ndarray | None:
        """Rotation (4, 4) in O near a turn (3, 3) that maps the object onto itself; None: none is.

        Points of the turned surface are registered to the surface, by rotation about its centroid,
        which every symmetry keeps. A spin that the surface of a round object does not show stays.
        """
        middle, arms = self._arms
        R = Rotation.from_matrix(turn)
        # no point is farther from the surface than that rotation moves it: most turns end here
        farthest = within_rad * np.linalg.norm(arms, axis=1) + tolerance * self.size_m
        if np.any(self._apart_m(R.apply(arms) + middle) > farthest):
            return None
        for _ in range(_TURNED_STEPS):
            turned = R.apply(arms)
            place, normal = self.closest(turned + middle)
            along = np.einsum("ij,ij->i", place - middle - turned, normal)
            step = np.linalg.lstsq(np.cross(turned, normal), along, rcond=_SPIN)[0]
            R = Rotation.from_rotvec(step) * R
        apart_m = self._apart_m(R.apply(arms) + middle)
        moved_rad = (R * Rotation.from_matrix(turn).inv()).magnitude()
        if apart_m.max() > tolerance * self.size_m or moved_rad > within_rad:
            return None
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = R.as_matrix(), middle - R.apply(middle)
        return found

    @cached_property
    def _arms(self) -> tuple[np.ndarray, np.ndarray]:
        """Centroid (3,) of the surface, and vectors (k, 3) from it to points of the surface."""
        middle = self.facet_areas @ self._corners.mean(axis=1) / self.facet_areas.sum()
        return middle, self.sample(_TURNED_POINTS)[0] - middle

    def _apart_m(self, points: np.ndarray) -> np.ndarray:
        """Distances (k,) of points (k, 3) in O from the surface."""
        return np.asarray(np.linalg.norm(points - self.closest(points).place, axis=1))

    @cached_property
    def creases(self) -> Creases | None:
        """Points along the edges at which two faces meet at a convex angle; None without any."""
        sides, _ = self._bends
        across = triangles_across(self.triangles)
        facet, corner = np.nonzero(
            (across > np.arange(len(across))[:, None]) & (sides > CREASE_RAD)
        )
        ends = (corner[:, None] + [1, 2]) % 3  # of the edge, in the first facet
        other = across[facet, corner]
        first, second = self.facet_normals[facet], self.facet_normals[other]
        # Counter-clockwise around the first face: out of it is along × normal.
        a, b = self._corners[facet, ends[:, 0]], self._corners[facet, ends[:, 1]]
        convex = np.einsum("ij,ij->i", second, cross(b - a, first)) > 0.0
        if not convex.any():
            return None
        facet, other, ends = facet[convex, None], other[convex, None], ends[convex]
        same = self.triangles[other] == self.triangles[facet, ends][:, :, None]
        corners = self._corners[facet, ends]  # (c, 2, 3), and their normals, (c, 2, 2, 3)
        normals = np.stack(
            [self._corner_normals[facet, ends], self._corner_normals[other, same.argmax(axis=2)]],
            axis=2,
        )
        length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        count = np.ceil(length / (_STEP * self.size_m)).astype(int)
        edge = np.repeat(np.arange(len(corners)), count)
        step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
        share = (step + 0.5) / count[edge]
        weights = np.column_stack([1.0 - share, share])
        smooth = np.einsum("ce,cefi->cfi", weights, normals[edge])
        smooth /= np.linalg.norm(smooth, axis=2, keepdims=True)
        return Creases(cKDTree(np.einsum("ce,cei->ci", weights, corners[edge])), smooth)

    def crossings(
        self, points: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All crossings of lines through points (k, 3) along unit directions, both in O.

        Number of the line (h,), place along it in m from the point, and whether it enters there.
        """
        # Start each ray just before the object's bounding sphere, where single precision is best.
        middle = np.einsum("ij,ij->i", self._centre - points, directions)
        miss = np.linalg.norm(points + middle[:, None] * directions - self._centre, axis=1)
        near = np.flatnonzero(miss <= self._radius)
        if not len(near):  # Open3D crashes on no rays
            return near, np.zeros(0), np.zeros(0, bool)
        start = points[near] + (middle[near] - 1.01 * self._radius)[:, None] * directions[near]
        hit, facet = self._scene.crossings(np.hstack([start, directions[near]]))
        line = near[hit]
        # The place again in double precision, from the plane of the facet that was hit.
        vectors, away = self._vectors[facet], self._corners[facet, 0] - points[line]
        slope = np.einsum("ij,ij->i", vectors, directions[line])
        distance = np.einsum("ij,ij->i", vectors, away)
        kept = np.abs(slope) > 1e-7 * self.facet_areas[facet]  # not along the facet
        return line[kept], distance[kept] / slope[kept], slope[kept] < 0.0

    def planes(
        self,
        # points, outward: (k, 3), in B: places on the membrane, m, and its unit normals there
        points: np.ndarray,
        outward: np.ndarray,
        T_B_O: np.ndarray,  # (4, 4)
        reach_m: float,  # points further from the object than this are not constrained
    ) -> Planes:
        """Constraints of points near the object."""
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
        turn = normal.swapaxes(1, 2) @ _slopes(self._corners[facet])
        normal = np.einsum("ki,kij->kj", weights, normal)
        length = np.linalg.norm(normal, axis=1)
        normal /= length[:, None]
        turn = _across(normal, turn / length[:, None, None])
        gap = np.einsum("ij,ij->i", away, self.facet_normals[facet])
        aside = np.linalg.norm(away - gap[:, None] * self.facet_normals[facet], axis=1)
        beside = weights.min(axis=1) < _ON_EDGE
        # Nearest to a sharp edge or corner, not to the face it belongs to.
        edge = beside & (aside > np.maximum(0.5 * np.abs(gap), _LEAST_M))
        if not self.solid:
            behind = np.einsum("ij,ij->i", self.facet_normals[facet], out) > 0.0
            sign = np.where(behind, -1.0, 1.0)
            gap = np.where(edge, np.inf, sign * gap)
            return Planes(gap, sign[:, None] * normal, sign[:, None, None] * turn)
        found, rounding_m = Planes(gap, normal, turn), (weights * self._rounding_m[facet]).sum(1)
        edge &= gap < 0.0
        around = np.flatnonzero(beside & (gap >= 0.0))
        self._round(found, around, x, facet, weights, rounding_m[around])
        if edge.any():
            gap[edge] = np.where(self._scene.contains(x[edge]), -1.0, 1.0) * np.linalg.norm(
                away[edge], axis=1
            )
            normal[edge], turn[edge] = away[edge] / gap[edge, None], 0.0
        wrong = (gap < 0.0) & (np.einsum("ij,ij->i", normal, out) > 0.0)
        if wrong.any():
            gap[wrong], normal[wrong] = self._way_back(x[wrong], out[wrong])
            turn[wrong] = 0.0
        return found._replace(gap=gap - rounding_m)

    def _round(
        self,
        found: Planes,
        some: np.ndarray,
        x: np.ndarray,
        facet: np.ndarray,
        weights: np.ndarray,
        rounding_m: np.ndarray,
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
        outside = np.einsum("ij,ij->i", from_start, cross(along, self.facet_normals[facets])) > 0.0
        between = (way > 0.0) & (way < length)
        corner = (side + np.where(way > 0.0, 2, 1)) % 3
        sides, corners = self._bends
        bend = np.where(between, sides[facets, side], corners[facets, corner])
        kept = (outside | ~between) & (bend > _FLAT)
        away = from_start - np.clip(way, 0.0, length)[:, None] * along
        distance = np.linalg.norm(away, axis=1)
        found.gap[some[kept]] = distance[kept]
        line = np.where(between[:, None], along, 0.0)
        line = line[:, :, None] * line[:, None, :]
        # There the smooth normal only turns along the side.
        found.turn[some[kept]] = line[kept] @ found.turn[some[kept]] @ line[kept]
        kept &= (bend > CREASE_RAD) & (distance > np.maximum(0.1 * rounding_m, _LEAST_M))
        some, normal = some[kept], away[kept] / distance[kept, None]
        plane = np.eye(3) - normal[:, :, None] * normal[:, None, :] - line[kept]
        plane[rounding_m[kept] == 0.0] = 0.0
        found.normal[some], found.turn[some] = normal, plane / distance[kept, None, None]

    @cached_property
    def _bends(self) -> tuple[np.ndarray, np.ndarray]:
        """Angles between facets, (m, 3), rad: across the side opposite each corner, at it."""
        triangles = self.triangles
        across = triangles_across(triangles)
        dots = np.einsum("ij,ikj->ik", self.facet_normals, self.facet_normals[across])
        sides = np.where(across >= 0, np.arccos(np.clip(dots, -1.0, 1.0)), 0.0)
        vertices = np.zeros(int(triangles.max()) + 1)
        for k in range(3):
            for end in (1, 2):
                np.maximum.at(vertices, triangles[:, (k + end) % 3], sides[:, k])
        return sides, vertices[triangles]

    def _way_back(self, x: np.ndarray, out: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Constraints of points nearest to the far side of a thin object: back to the near side."""
        facet, distance = self._scene.cast(np.hstack([x, -out]))
        met = np.isfinite(distance)
        facet[~met] = 0
        normal = self.facet_normals[facet]
        gap = np.einsum("ij,ij->i", x - self._corners[facet, 0], normal)
        return np.where(met & (gap < 0.0), gap, np.inf), normal

    def _smoothed(self) -> np.ndarray:
        """Unit normals (m, 3, 3) at the facets' corners: means over facets of the same surface."""
        vertices = self.triangles.ravel()
        order, counts = np.argsort(-vertices, kind="stable")[::-1], np.bincount(vertices)
        first, sums = np.cumsum(counts) - counts, np.empty((len(vertices), 3))
        for k in np.unique(counts[counts > 0]):  # vertices of k facets at once
            corners = order[first[counts == k, None] + np.arange(k)]
            rows, step = max(1, _PAIRS // k), max(1, _PAIRS // k**2)
            for some in (corners[at : at + step] for at in range(0, len(corners), step)):
                normals, vectors = self.facet_normals[some // 3], self._vectors[some // 3]
                for at in range(0, k, rows):
                    dots = normals[:, at : at + rows] @ normals.swapaxes(1, 2)
                    alike = (dots > np.cos(CREASE_RAD)).astype(float)
                    sums[some[:, at : at + rows]] = np.einsum("vij,vjk->vik", alike, vectors)
        return (sums / np.linalg.norm(sums, axis=1, keepdims=True)).reshape(-1, 3, 3)


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


def _is_watertight(triangles: np.ndarray) -> bool:
    """Whether every edge has two triangles that run along it in opposite directions."""
    n = int(triangles.max()) + 1
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    forward, backward = np.sort(start * n + end), np.sort(end * n + start)
    once = bool((np.diff(forward) > 0).all())
    return once and bool((forward == backward).all())
