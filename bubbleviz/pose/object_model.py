"""An object made ready for registration: its surface, smooth normals and creases, found once."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh, TriangleScene, area_vectors
from bubbleviz.rigid_object import RigidObject

CREASE_RAD = np.radians(20.0)
"""Angle between faces from which their common edge is an edge of the object, and not of its mesh:
a circle of 20 facets still counts as round."""

_STEP = 0.01  # distance of points along creases over the object's size

_LARGEST = 20.0
"""Size of an object over that of the bubble beyond which one of them is in other units."""


@dataclass(frozen=True)
class Closest:
    """The places on an object that are closest to some points, all in O."""

    place: np.ndarray  # (k, 3)
    normal: np.ndarray  # (k, 3), outward surface normal there, smooth but across creases


@dataclass(frozen=True)
class Creases:
    """Points along the convex edges of an object, in O."""

    tree: Any  # of the points (c, 3)
    normals: np.ndarray  # (c, 2, 3), of the two faces that meet there


class ObjectModel:
    """Surface of a rigid object, to be asked for closest points.

    Attributes
    ----------
    obj : RigidObject
    size_m : float
        Largest extent along its own axes.
    creases : Creases or None
        None where it has none.

    Raises
    ------
    InputError
        The mesh has no area.
    """

    def __init__(
        self,
        obj: RigidObject,  # watertight or not; its triangles face outward
    ) -> None:
        self.obj = obj
        self.size_m = float(np.ptp(obj.vertices, axis=0).max())
        vectors = area_vectors(obj.vertices, obj.triangles)
        areas = np.linalg.norm(vectors, axis=1)
        if not areas.sum() > 1e-8 * self.size_m**2:
            raise InputError(f"object {obj.name}: its triangles have no area; export a surface")
        kept = areas > 1e-12 * self.size_m**2
        self.triangles = obj.triangles[kept]
        self.face_areas, self.face_normals = areas[kept], vectors[kept] / areas[kept, None]
        self.area_m2 = float(areas.sum())
        self._corner_normals = _smooth_normals(self)
        self.creases = _creases(self)
        self._scene = TriangleScene(obj.vertices, self.triangles)

    def closest(self, points: np.ndarray) -> Closest:
        """Closest places to points (k, 3) in O."""
        place, triangle, weights = self._scene.closest(points)
        normal = np.einsum("ij,ijk->ik", weights, self._corner_normals[triangle])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return Closest(place, normal)

    def sample(self, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Points (count, 3) spread evenly over the surface, and their normals, in O."""
        random = np.random.default_rng(seed)
        face = random.choice(len(self.triangles), count, p=self.face_areas / self.face_areas.sum())
        a, b = random.random((2, count))
        a, b = np.where(a + b > 1.0, 1.0 - a, a), np.where(a + b > 1.0, 1.0 - b, b)
        weights = np.column_stack([1.0 - a - b, a, b])
        points = np.einsum("ij,ijk->ik", weights, self.obj.vertices[self.triangles[face]])
        return points, self.face_normals[face]


def check_size(obj: RigidObject, mesh: MembraneMesh) -> None:
    """Refuse an object that is in other units than the bubble.

    Raises InputError.
    """
    size = float(np.ptp(obj.vertices, axis=0).max())
    bubble = float(np.ptp(mesh.nodes, axis=0).max())
    if size > _LARGEST * bubble:
        raise InputError(
            f"object {obj.name}: {size:.4g} m long, {size / bubble:.0f} times the bubble; "
            "is it in millimetres? scale it, or end its file name in _mm"
        )


def _smooth_normals(model: ObjectModel) -> np.ndarray:
    """Normals at the corners of the triangles, (m, 3, 3): means over one side of any crease."""
    triangles, normals = model.triangles, model.face_normals
    corners = model.obj.vertices[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    cosine = -np.einsum("ijk,ijk->ij", sides, np.roll(sides, 1, axis=1))
    angle = np.arccos(np.clip(cosine / (lengths * np.roll(lengths, 1, axis=1)), -1.0, 1.0))
    vertex = triangles.ravel()
    face = np.repeat(np.arange(len(triangles)), 3)
    order = np.argsort(vertex, kind="stable")
    starts = np.searchsorted(vertex[order], np.arange(len(model.obj.vertices) + 1))
    result = np.empty((len(vertex), 3))
    for first, last in pairwise(starts):
        own = order[first:last]
        around = normals[face[own]]
        alike = around @ around.T > np.cos(CREASE_RAD)
        result[own] = (alike * angle.ravel()[own]) @ around
    return (result / np.linalg.norm(result, axis=1, keepdims=True)).reshape(-1, 3, 3)


def _creases(model: ObjectModel) -> Creases | None:
    """Points along the edges at which two faces meet at a convex angle."""
    n = len(model.obj.vertices)
    start, end = model.triangles.ravel(), np.roll(model.triangles, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(model.triangles)), 3)
    order = np.argsort(start * n + end)
    key = (start * n + end)[order]
    where = np.minimum(np.searchsorted(key, end * n + start), len(key) - 1)
    paired = (key[where] == end * n + start) & (start < end)
    one, two = face[paired], face[order[where[paired]]]
    a, b = model.obj.vertices[start[paired]], model.obj.vertices[end[paired]]
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    first, second = model.face_normals[one], model.face_normals[two]
    # Counter-clockwise around the first face: out of it is along × normal.
    leaves = np.cross(along, first)
    turn = np.einsum("ij,ij->i", first, second)
    sharp = (turn < np.cos(CREASE_RAD)) & (np.einsum("ij,ij->i", second, leaves) > 0.0)
    if not sharp.any():
        return None
    a, b, first, second = a[sharp], b[sharp], first[sharp], second[sharp]
    count = np.ceil(np.linalg.norm(b - a, axis=1) / (_STEP * model.size_m)).astype(int)
    edge = np.repeat(np.arange(len(a)), count)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = ((step + 0.5) / count[edge])[:, None]
    points = (1.0 - share) * a[edge] + share * b[edge]
    return Creases(cKDTree(points), np.stack([first, second], axis=1)[edge])


# Rotations that take an object onto itself: poses that differ by one are the same.


_ALIKE = 2e-3  # distance over the object's size below which surfaces are the same

_FOLDS = (2, 3, 4, 5, 6, 8)  # of prisms that people make
_CIRCLE = 360  # turns of a round object: a degree apart
_MOST = 4 * _CIRCLE  # motions: a round object upside down and mirrored


def symmetries(model: ObjectModel) -> np.ndarray:
    """Transforms (s, 4, 4) of O that take the object onto itself, the identity first.

    A round object has one for each degree; a ball, all of whose rotations are alike, the identity
    alone: nothing of its rotation is ever determined.
    """
    center, axes = _axes(model)
    round_axes = [a for a in axes if _same(model, center, Rotation.from_rotvec(a).as_matrix())]
    if len(round_axes) > 1:
        return _transforms(np.eye(3)[None], center)
    turns = [np.eye(3)]
    for axis in axes:
        if any(abs(axis @ other) > 1.0 - 1e-6 for other in round_axes):
            continue
        turns += [
            R
            for fold in _FOLDS
            if _same(
                model,
                center,
                R := Rotation.from_rotvec(2.0 * np.pi / fold * axis).as_matrix(),
            )
        ]
    if not round_axes:
        return _transforms(_closed(np.array(turns)), center)
    angles = np.arange(_CIRCLE) * 2.0 * np.pi / _CIRCLE
    circle = Rotation.from_rotvec(angles[:, None] * round_axes[0]).as_matrix()
    flips = [R for R in turns if round_axes[0] @ R @ round_axes[0] < -0.5][:1]
    return _transforms(np.concatenate([circle, *(flip @ circle for flip in flips)]), center)


def _axes(model: ObjectModel) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the surface, and unit axes (a, 3) about which the object may be symmetric."""
    corners = model.obj.vertices[model.triangles]
    middles = corners.mean(axis=1)
    weight = model.face_areas / model.face_areas.sum()
    center = weight @ middles
    arms = np.concatenate([middles, *(0.5 * (corners[:, k] + middles) for k in range(3))])
    arms = arms - center
    shares = np.tile(weight, 4)
    _, vectors = np.linalg.eigh((arms.T * shares) @ arms)
    _, different = np.unique(np.round(model.face_normals, 3), axis=0, return_index=True)
    normals = model.face_normals[different]  # as they are: rounded axes close no group
    largest = normals[np.argsort(-np.abs(normals).max(axis=1))][:40]
    between = [a + b for a, b in combinations(largest[:14], 2)]
    candidates = np.concatenate([vectors.T, np.eye(3), largest, np.reshape(between, (-1, 3))])
    chosen: list[np.ndarray] = []
    for candidate in candidates:
        length = np.linalg.norm(candidate)
        if length > 1e-6 and all(abs(candidate @ c) < (1.0 - 1e-5) * length for c in chosen):
            chosen.append(candidate / length)
    return center, np.array(chosen)


def _same(model: ObjectModel, center: np.ndarray, R: np.ndarray) -> bool:
    """Whether the turned vertices lie on the surface."""
    turned = (model.obj.vertices - center) @ R.T + center
    way = turned - model.closest(turned).place
    return bool(np.linalg.norm(way, axis=1).max() < _ALIKE * model.size_m)


def _closed(turns: np.ndarray) -> np.ndarray:
    """All products of some rotations."""
    group = [np.eye(3)]
    new = list(turns)
    while new and len(group) < _MOST:
        R = new.pop()
        if any(np.abs(R - known).max() < 1e-3 for known in group):
            continue
        group.append(R)
        new += [R @ other for other in turns]
    return np.array(group)


def _transforms(rotations: np.ndarray, center: np.ndarray) -> np.ndarray:
    result = np.tile(np.eye(4), (len(rotations), 1, 1))
    result[:, :3, :3] = rotations
    result[:, :3, 3] = center - rotations @ center
    return result
