"""Where the camera's rays meet the membrane, in the reference or any current configuration.

A membrane that the camera sees all of at once, each point of its image showing one triangle, is
walked on: neighbouring rays meet neighbouring triangles. Rays are cast by Open3D, which takes a
fifth of a second to load, only at one that folds over itself.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.membrane.mesh import area_vectors, faces_from, triangles_across

_WALK = 4  # triangles that a ray may walk over; it is cast again before more are needed
_FAR_WALK = 64  # the same where it is not cast again: more than there are across a dent

_COARSER = 8  # rays for one that is walked before them, and from whose triangle they start

_OUTSIDE = 1e-6  # barycentric coordinate below which a ray has left its triangle
_STRAIGHT = 1e-9  # sine by which the seen rim may bend inward: rounding


@dataclass(frozen=True)
class Hits:
    """Rays that meet the mesh."""

    ray: np.ndarray  # (k,) int, index of each ray that hits, ascending
    triangle: np.ndarray  # (k,) int, triangle it hits
    barycentric: np.ndarray  # (k, 3), coordinates of the hit on that triangle
    range_m: np.ndarray  # (k,), distance from the origin along the unit ray, m
    # (k, 3), ∂(range)/∂u of the triangle's three nodes for motion along their reference normals:
    # b_i (n_i·m)/(r̂·m) with the facet's unit normal m. Eq. 19 has b_i (r̂·n̂) instead, which is
    # the projection of the motion on the ray and not the derivative of the range.
    sensitivity: np.ndarray

    def of(self, some: np.ndarray) -> Hits:
        """Hits number `some` (j,)."""
        return Hits(*(getattr(self, field.name)[some] for field in fields(self)))

    def with_others(self, some: np.ndarray, others: Hits) -> Hits:
        """The same with `others` in place of those number `some` (j,)."""
        arrays = [getattr(self, field.name).copy() for field in fields(self)]
        for array, field in zip(arrays, fields(self), strict=True):
            array[some] = getattr(others, field.name)
        return Hits(*arrays)


class _Facets(NamedTuple):
    """Triangles seen from the rays' origin."""

    faces: np.ndarray  # (m, 3, 3), cross products of the corners, opposite each corner
    facing: np.ndarray  # (m, 3), node normals times the facet's vector
    offset: np.ndarray  # (m,), distance of its plane times the length of that vector

    @classmethod
    def of(cls, local: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> _Facets:
        """Of triangles (m, 3) between nodes (n, 3) from the origin."""
        # r̂·(b×c) and its turns are the barycentric coordinates up to their sum, r̂·facet.
        faces = faces_from(local, triangles)
        facet = faces[:, 0] + faces[:, 1] + faces[:, 2]
        facing = np.einsum("mkj,mj->mk", normals[triangles], facet)
        return cls(faces, facing, np.einsum("mj,mj->m", local[triangles[:, 0]], facet))


class RayCaster:
    """Casts one bundle of rays from one origin onto a mesh whose nodes may move."""

    def __init__(
        self,
        origin: np.ndarray,  # (3,), camera centre c in B, m
        directions: np.ndarray,  # (k, 3), unit rays r̂ in B
        triangles: np.ndarray,  # (m, 3) int
    ) -> None:
        self.origin = np.asarray(origin, float)
        self.directions = np.ascontiguousarray(directions, float)
        self.triangles = triangles
        self._indices = np.ascontiguousarray(triangles, np.uint32)

    @cached_property
    def _rays(self) -> np.ndarray:
        """Nodes are moved by −origin before single precision sees them: all rays start at zero."""
        rays = np.zeros((len(self.directions), 6), np.float32)
        rays[:, 3:] = self.directions
        return rays

    def cast(
        self,
        nodes: np.ndarray,  # (n, 3), current node positions in B, m
        normals: np.ndarray,  # (n, 3), reference node normals, the directions in which nodes move
        rays: np.ndarray | None = None,  # (j,) int
    ) -> Hits:
        """Nearest hit of every ray (or of those numbered by `rays`) on the mesh with `nodes`."""
        return self.met(nodes, normals, self.first(nodes, rays), rays)

    def met(
        self,
        nodes: np.ndarray,
        normals: np.ndarray,
        first: np.ndarray,
        rays: np.ndarray | None = None,
    ) -> Hits:
        """The same where the triangle that each ray meets is known: `first`."""
        hit = np.flatnonzero(first >= 0)
        ray = hit if rays is None else np.asarray(rays)[hit]
        # in double precision, on the triangle that single precision found
        return self._meet(self._facets(nodes, normals), ray, first[hit])

    def first(self, nodes: np.ndarray, rays: np.ndarray | None = None) -> np.ndarray:
        """Triangle that each ray (or each of some) meets first, (k,); −1 where it meets none."""
        local = nodes - self.origin
        faces, some = faces_from(local, self.triangles), slice(None) if rays is None else rays
        if self._seen_at_once(local, faces, some):
            there, arrived = self._found(faces.astype(np.float32), self._rays[some, 3:])
            return np.where(arrived, there, -1)
        found = TriangleScene(local, self._indices).cast(self._rays[some])
        return np.where(np.isfinite(found.distance), found.triangle, -1)

    def _seen_at_once(self, local: np.ndarray, faces: np.ndarray, rays: slice | np.ndarray) -> bool:
        """Whether no ray meets two triangles, nor leaves the mesh on its walk to the one it meets.

        So it is where all triangles face the rays' origin and the rim is convex as seen from there.
        """
        axis = local.mean(axis=0)
        facing = np.einsum("mj,mj->m", local[self.triangles[:, 0]], faces[:, 0]) > 0.0
        before = (local @ axis > 0.0).all() and (self.directions[rays] @ axis > 0.0).all()
        if not (facing.all() and before):
            return False
        sides = faces[self._across < 0]
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        beside = sides @ (local / np.linalg.norm(local, axis=1, keepdims=True)).T
        return bool((beside > -_STRAIGHT).all())

    def _found(self, faces: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Triangle (j,) that each of rays (j, 3) is on, wherever it is, and whether it meets that.

        The mesh is one that is seen at once.
        """
        start = np.zeros(len(ray), int)
        if len(ray) > _COARSER:
            start = self._found(faces, ray[::_COARSER])[0].repeat(_COARSER)[: len(ray)]
        return self._walked(faces, ray, start, len(faces))

    def ranges(self, nodes: np.ndarray, rays: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """Ranges (j,) of some rays, each of which walks to its triangle from one close by.

        On a surface without folds the same as `cast` finds, in a fraction of the time.

        Parameters
        ----------
        nodes : (n, 3) array
        rays, triangle : (j,) int array
            Triangles of −1 are none.

        Returns
        -------
        (j,) array
            m; NaN where there is no triangle, and where the ray leaves the mesh.
        """
        local = nodes - self.origin
        faces = faces_from(local, self.triangles)
        single = faces.astype(np.float32)
        there, arrived = self._walked(single, self._rays[rays, 3:], triangle, _FAR_WALK)
        facet = faces[:, 0] + faces[:, 1] + faces[:, 2]
        offset = np.einsum("mj,mj->m", local[self.triangles[:, 0]], facet)
        along = np.einsum("rj,rj->r", facet.take(there, axis=0), self.directions.take(rays, axis=0))
        return np.where(arrived, offset[there] / along, np.nan)

    def _walked(
        self, faces: np.ndarray, ray: np.ndarray, triangle: np.ndarray, most: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Triangle (j,) that each ray is on after a walk over some, and whether it meets that.

        Faces and rays (j, 3) are in single precision.
        """
        there, arrived = triangle.copy(), triangle >= 0
        walking = np.flatnonzero(arrived)
        for _ in range(most):
            seen = faces.take(there[walking], axis=0)
            volumes = np.einsum("rkj,rj->kr", seen, ray[walking])
            lowest = np.minimum(np.minimum(volumes[0], volumes[1]), volumes[2])
            leaving = np.flatnonzero(lowest < -_OUTSIDE * volumes.sum(axis=0))
            walking, out = walking[leaving], volumes[:, leaving].argmin(axis=0)
            following = self._across[there[walking], out]
            arrived[walking[following < 0]] = False
            walking, following = walking[following >= 0], following[following >= 0]
            if not len(walking):
                return there, arrived
            there[walking] = following
        arrived[walking] = False
        return there, arrived

    @cached_property
    def _across(self) -> np.ndarray:
        return triangles_across(self.triangles)

    def recast(self, nodes: np.ndarray, normals: np.ndarray, hits: Hits) -> Hits:
        """Hits of the same rays after the nodes moved a little: each walks to its triangle.

        A ray whose triangle is several further away ends on the plane of one close by.
        """
        facets = self._facets(nodes, normals)
        single = facets.faces.astype(np.float32)
        there, _ = self._walked(single, self._rays[hits.ray, 3:], hits.triangle, _WALK)
        return self._meet(facets, hits.ray, there)

    def slopes(self, nodes: np.ndarray, hits: Hits) -> np.ndarray:
        """m/(r̂·m) of the facets that are hit, (k, 3): range gained by their motion in B."""
        facet = area_vectors(nodes, self.triangles)[hits.triangle]
        along = np.einsum("ij,ij->i", facet, self.directions[hits.ray])
        return facet / along[:, None]

    def _facets(self, nodes: np.ndarray, normals: np.ndarray) -> _Facets:
        return _Facets.of(nodes - self.origin, normals, self.triangles)

    def _meet(self, facets: _Facets, ray: np.ndarray, triangle: np.ndarray) -> Hits:
        """Hits of rays (k,) on the planes of triangles (k,)."""
        faces = facets.faces.take(triangle, axis=0)
        volumes = np.einsum("rkj,rj->rk", faces, self.directions.take(ray, axis=0))
        along = volumes[:, 0] + volumes[:, 1] + volumes[:, 2]
        barycentric = volumes / along[:, None]
        sensitivity = barycentric * facets.facing.take(triangle, axis=0) / along[:, None]
        return Hits(ray, triangle, barycentric, facets.offset[triangle] / along, sensitivity)
