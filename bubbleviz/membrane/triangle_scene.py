"""Ray casting and closest points on triangles, by Open3D."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np

from bubbleviz.lazy_imports import import_without


class RayHits(NamedTuple):
    """First triangle that each ray meets."""

    triangle: np.ndarray  # (k,) int, undefined where nothing is met
    # (k,), along the ray in lengths of its direction; inf where nothing is met
    distance: np.ndarray


class ClosestPoints(NamedTuple):
    """Closest point of the triangles to each of some points."""

    point: np.ndarray  # (k, 3), m
    triangle: np.ndarray  # (k,) int, the one it is on
    barycentric: np.ndarray  # (k, 3), its coordinates there


class TriangleScene:
    """Triangles, in single precision: what needs more is computed again from the triangle found.

    Parameters
    ----------
    vertices : (n, 3) array
        m.
    triangles : (m, 3) int array
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        # In a notebook Open3D would ask for its viewer while it is loaded, and fail without
        os.environ["OPEN3D_DISABLE_WEB_VISUALIZER"] = "true"
        import_without("open3d", "visualization")
        from open3d import core  # half a second, which the window and most commands start without
        from open3d.t.geometry import RaycastingScene

        self._tensor_of = core.Tensor.from_numpy
        self._scene = RaycastingScene()
        indices = self._tensor_of(np.ascontiguousarray(triangles, np.uint32))
        self._scene.add_triangles(self._single(vertices), indices)

    def cast(self, rays: np.ndarray) -> RayHits:
        """First hits of rays (k, 6): origins in m, directions."""
        found = self._scene.cast_rays(self._single(rays))
        return RayHits(_integers(found["primitive_ids"]), _doubles(found["t_hit"]))

    def crossings(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ray and triangle of every hit of rays (k, 6), at least one of them."""
        found = self._scene.list_intersections(self._single(rays))
        return _integers(found["ray_ids"]), _integers(found["primitive_ids"])

    def closest(self, points: np.ndarray) -> ClosestPoints:
        """Closest points to points (k, 3), at least one of them."""
        found = self._scene.compute_closest_points(self._single(points))
        u, v = _doubles(found["primitive_uvs"]).T
        barycentric = np.column_stack([1.0 - u - v, u, v])
        return ClosestPoints(
            _doubles(found["points"]), _integers(found["primitive_ids"]), barycentric
        )

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether points (k, 3) are inside the watertight surface that the triangles are."""
        inside: np.ndarray = self._scene.compute_occupancy(self._single(points)).numpy() > 0.5
        return inside

    def _single(self, values: np.ndarray) -> Any:
        return self._tensor_of(np.ascontiguousarray(values, np.float32))


def _integers(tensor: Any) -> np.ndarray:
    return tensor.numpy().astype(np.int64)


def _doubles(tensor: Any) -> np.ndarray:
    return tensor.numpy().astype(np.float64)
