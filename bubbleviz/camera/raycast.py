"""Where the camera's rays meet the membrane, in the reference or any current configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.deferred import import_without


@dataclass(frozen=True)
class Hits:
    """Rays that meet the mesh.

    Attributes
    ----------
    ray : (k,) int array
        Index of each ray that hits, ascending.
    triangle : (k,) int array
        Triangle it hits.
    barycentric : (k, 3) array
        Coordinates of the hit on that triangle.
    range_m : (k,) array
        Distance from the origin along the unit ray, m.
    sensitivity : (k, 3) array
        ∂(range)/∂u of the triangle's three nodes for motion along their reference normals:
        b_i (n_i·m)/(r̂·m) with the facet's unit normal m. Eq. 19 has b_i (r̂·n̂) instead, which is
        the projection of the motion on the ray and not the derivative of the range.
    """

    ray: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray
    range_m: np.ndarray
    sensitivity: np.ndarray


class RayCaster:
    """Casts one bundle of rays from one origin onto a mesh whose nodes may move.

    Parameters
    ----------
    origin : (3,) array
        Camera centre c in B, m.
    directions : (k, 3) array
        Unit rays r̂ in B.
    triangles : (m, 3) int array
    """

    def __init__(self, origin: np.ndarray, directions: np.ndarray, triangles: np.ndarray) -> None:
        import_without("open3d", "visualization")
        from open3d import core

        self.origin = np.asarray(origin, float)
        self.directions = np.ascontiguousarray(directions, float)
        self.triangles = triangles
        self._indices = core.Tensor.from_numpy(np.ascontiguousarray(triangles, np.uint32))
        # Nodes are moved by −origin before single precision sees them: all rays start at zero.
        rays = np.zeros((len(directions), 6), np.float32)
        rays[:, 3:] = directions
        self._rays = core.Tensor.from_numpy(rays)

    def cast(self, nodes: np.ndarray, normals: np.ndarray, rays: np.ndarray | None = None) -> Hits:
        """Nearest hit of every ray (or of those numbered by `rays`) on the mesh with `nodes`.

        Parameters
        ----------
        nodes : (n, 3) array
            Current node positions in B, m.
        normals : (n, 3) array
            Reference node normals, the directions in which nodes move.
        rays : (j,) int array, optional
        """
        from open3d import core
        from open3d.t.geometry import RaycastingScene

        local = nodes - self.origin
        scene = RaycastingScene()
        scene.add_triangles(core.Tensor.from_numpy(local.astype(np.float32)), self._indices)
        bundle = self._rays if rays is None else core.Tensor.from_numpy(self._rays.numpy()[rays])
        found = scene.cast_rays(bundle)["primitive_ids"].numpy()
        ray = np.flatnonzero(found != RaycastingScene.INVALID_ID)
        triangle = found[ray].astype(np.int64)
        return self._refine(
            local, normals, ray if rays is None else np.asarray(rays)[ray], triangle
        )

    def _refine(
        self, local: np.ndarray, normals: np.ndarray, ray: np.ndarray, triangle: np.ndarray
    ) -> Hits:
        """Hit in double precision on the triangle that single precision found."""
        corners = local[self.triangles]
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        # r̂·(b×c) and its turns are the barycentric coordinates up to their sum, r̂·facet.
        faces = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
        facet = faces.sum(axis=1)
        facing = np.einsum("mkj,mj->mk", normals[self.triangles], facet)
        offset = np.einsum("mj,mj->m", a, facet)
        volumes = np.einsum("rkj,rj->rk", faces[triangle], self.directions[ray])
        along = volumes.sum(axis=1)
        barycentric = volumes / along[:, None]
        sensitivity = barycentric * facing[triangle] / along[:, None]
        return Hits(ray, triangle, barycentric, offset[triangle] / along, sensitivity)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of rows, (m, 3); several times faster than `np.cross`."""
    out = np.empty_like(a)
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[:, k] = a[:, i] * b[:, j] - a[:, j] * b[:, i]
    return out
