"""Where an object touches the membrane: its own points against the membrane's triangles.

Points of the object and not nodes of the membrane are in contact, so that the edge of a face may
be anywhere on a triangle, and the contact follows a pose smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.membrane.mesh import cross
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.pose_options import PressOptions

_TRIES = 30
_MOST = 200_000  # random points for each one that is kept, and in all
_KEENEST = 0.1
"""1 + cosine between the normals of an edge of 26°. Keener ones are rounded as if they were that:
the tip of a rounded blade would be far back."""


def contact_samples(model: ObjectModel, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) in O about `spacing_m` apart, half that along creases, and normals (k, 2, 3).

    Along a crease the two normals are those of its faces, elsewhere they are the same.
    """
    count = min(_MOST, int(_TRIES * model.area_m2 / spacing_m**2) + _TRIES)
    points, single = model.sample(count)
    normals = np.repeat(single[:, None], 2, axis=1)
    if model.creases is None:
        kept = _thinned(points, spacing_m)
        return points[kept], normals[kept]
    edge = np.asarray(model.creases.tree.data)
    distance, _ = model.creases.tree.query(points)
    clear = distance > 0.5 * spacing_m
    points, normals = points[clear], normals[clear]
    kept, along = _thinned(points, spacing_m), _thinned(edge, 0.5 * spacing_m)
    return (
        np.concatenate([edge[along], points[kept]]),
        np.concatenate([model.creases.normals[along], normals[kept]]),
    )


def _thinned(points: np.ndarray, spacing_m: float) -> np.ndarray:
    """Indices of one point for each cube of a grid, the one closest to its centre."""
    cube = np.floor(points / spacing_m)
    off = np.sum((points / spacing_m - cube - 0.5) ** 2, axis=1)
    order = np.lexsort((off, *cube.T))
    new = np.any(np.diff(cube[order], axis=0) != 0.0, axis=1)
    return order[np.concatenate([np.ones(min(1, len(order)), bool), new])]


@dataclass(frozen=True)
class Touching:
    """Points of the object that are inside the membrane."""

    points: np.ndarray  # (c, 3), in B
    triangle: np.ndarray  # (c,) int, of the membrane, the one below each
    corners: np.ndarray  # (c, 3) int, its nodes
    weights: np.ndarray  # (c, 3), barycentric coordinates there
    gradients: np.ndarray  # (c, 3, 3), of these in B, by corner, 1/m
    # (c, 3), direction in which the object pushes the membrane, out of the object
    normals: np.ndarray
    force_n: np.ndarray  # (c,), with which it pushes
    stiffness_n_per_m: np.ndarray  # (c,), of the point
    edge: np.ndarray  # (c,) bool, on an edge of the object
    # (c, 3), motion of points on edges by the radius of these; 0 on faces. The middle of a rounding
    # lies inside both faces by its radius, and the point on it that pushes as far from there.
    rounding: np.ndarray

    def on_nodes(self, forces: np.ndarray, count: int) -> np.ndarray:
        """Forces (c, 3) on the points, shared between the nodes (count, 3)."""
        shares = self.weights[:, :, None] * forces[:, None]
        return _gathered(self.corners, shares, count)

    def pulled_along(self, motions: np.ndarray, count: int) -> np.ndarray:
        """Change of the forces on the nodes (count, 3) as the points move by motions (c, 3).

        The points sink in, and what they carry moves over the triangle with them.
        """
        sinking = np.einsum("ci,ci->c", self.normals, motions) * self.stiffness_n_per_m
        over = np.einsum("caj,cj->ca", self.gradients, motions) * self.force_n[:, None]
        shares = sinking[:, None] * self.weights + over
        return _gathered(self.corners, shares[:, :, None] * self.normals[:, None], count)

    def blocks(self, triangles: int) -> np.ndarray:
        """Stiffness against motions of the nodes, as `RubberMembrane.tangent` adds it."""
        outer = self.normals[:, :, None] * self.normals[:, None]
        outer *= self.stiffness_n_per_m[:, None, None]
        blocks = np.empty((6, 3, 3, triangles))
        pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
        for block, (a, b) in zip(blocks, pairs, strict=True):
            shares = self.weights[:, a] * self.weights[:, b]
            for i in range(3):
                for j in range(3):
                    values = shares * outer[:, i, j]
                    block[i, j] = np.bincount(self.triangle, values, minlength=triangles)
        return blocks


class ObjectContact:
    """Finds where one object touches a membrane whose nodes move."""

    def __init__(
        self,
        model: ObjectModel,
        spacing_m: float,  # distance of the points on the object
        # pressure_pa, tension_n_per_m: under which a face and an edge sink in by the softness
        pressure_pa: float,
        tension_n_per_m: float,
        options: PressOptions,
    ) -> None:
        self._options = options
        self._points, self._normals = contact_samples(model, spacing_m)
        self._edge = np.any(self._normals[:, 0] != self._normals[:, 1], axis=1)
        both = self._normals.sum(axis=1)
        one_and_cosine = 0.5 * np.einsum("ij,ij->i", both, both)
        self._core = both / np.maximum(one_and_cosine, _KEENEST)[:, None]
        face, edge = pressure_pa * spacing_m**2, tension_n_per_m * 0.5 * spacing_m
        self._stiffness = np.where(self._edge, edge, face) / options.softness_m
        self.forget()

    def forget(self) -> None:
        """Begin anew with the directions in which edges push."""
        self._pushing = np.zeros_like(self._points)

    def touching(self, x: np.ndarray, triangles: np.ndarray, T_B_O: np.ndarray) -> Touching:
        """Points inside the membrane with nodes x (n, 3) and triangles (m, 3)."""
        R = T_B_O[:3, :3]
        places = x[triangles]
        vectors = cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
        points, margin = self._points @ R.T + T_B_O[:3, 3], self._options.deepest_m
        low, high = places.min(axis=(0, 1)) - margin, places.max(axis=(0, 1)) + margin
        close = np.flatnonzero(np.all((points > low) & (points < high), axis=1))
        if not len(close):
            close = np.zeros(1, int)  # any one: it is too far away
        found = TriangleScene(x, triangles).closest(points[close])
        corners, weights = triangles[found.triangle], found.barycentric
        smooth = _gathered(triangles, np.repeat(vectors[:, None], 3, axis=1), len(x))
        smooth = np.einsum("ci,cij->cj", weights, smooth[corners])
        smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
        normals = self._normals[close] @ R.T
        pushing = self._turned(close, normals, -smooth, R)
        facing = np.einsum("cj,cij->ci", smooth, normals).min(axis=1) < self._options.sideways
        way = np.einsum("ci,cij->cj", weights, x[corners]) - points[close]
        depth = -np.einsum("ij,ij->i", way, pushing)
        near = np.linalg.norm(way, axis=1) < self._options.deepest_m
        inside = np.flatnonzero(facing & near & (depth > 0.0))
        kept, corners = close[inside], corners[inside]
        return Touching(
            points=points[kept],
            triangle=found.triangle[inside],
            corners=corners,
            weights=weights[inside],
            gradients=_gradients(x[corners]),
            normals=pushing[inside],
            force_n=self._stiffness[kept] * depth[inside],
            stiffness_n_per_m=self._stiffness[kept],
            edge=self._edge[kept],
            rounding=pushing[inside] - self._core[kept] @ R.T,
        )

    def _turned(
        self, which: np.ndarray, normals: np.ndarray, inward: np.ndarray, R: np.ndarray
    ) -> np.ndarray:
        """Directions (k, 3) in which points push the membrane.

        A face pushes along its normal, an edge along the membrane's own (`inward`), as far as that
        lies between those of the two faces. The half of it that is the last one keeps Newton's
        method from going to and fro.
        """
        first, second = normals[:, 0], normals[:, 1]
        edge = self._edge[which]
        mixed = _between(first[edge], second[edge], inward[edge])
        before = self._pushing[which[edge]] @ R.T
        mixed += before
        mixed /= np.linalg.norm(mixed, axis=1, keepdims=True)
        self._pushing[which[edge]] = mixed @ R
        pushing = first.copy()
        pushing[edge] = mixed
        return pushing


def _between(first: np.ndarray, second: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Unit vectors (k, 3) closest to those wanted in the cones of two unit vectors."""
    c, a, b = (np.einsum("ij,ij->i", *pair) for pair in
               ((first, second), (wanted, first), (wanted, second)))  # fmt: skip
    by_first, by_second = np.maximum(a - c * b, 0.0), np.maximum(b - c * a, 0.0)
    none = by_first + by_second == 0.0
    by_first[none], by_second[none] = 1.0, 1.0
    mixed = by_first[:, None] * first + by_second[:, None] * second
    unit: np.ndarray = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
    return unit


def _gradients(places: np.ndarray) -> np.ndarray:
    """Gradients (c, 3, 3) of the barycentric coordinates of triangles (c, 3, 3), by corner, 1/m."""
    opposite = np.roll(places, -2, axis=1) - np.roll(places, -1, axis=1)
    vectors = cross(opposite[:, 2], -opposite[:, 1])
    scaled = vectors / np.einsum("ij,ij->i", vectors, vectors)[:, None]
    return np.stack([cross(scaled, opposite[:, corner]) for corner in range(3)], axis=1)


def _gathered(corners: np.ndarray, shares: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, 3) at the nodes of shares (c, 3, 3) of corners (c, 3)."""
    flat = corners.ravel()
    sums = [np.bincount(flat, shares[:, :, i].ravel(), minlength=count) for i in range(3)]
    return np.stack(sums, axis=1)
