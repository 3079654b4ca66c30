"""Intersections of camera rays with the membrane, in the reference or a deformed configuration.

If no part of the membrane hides another from the camera, rays walk over the mesh: from the triangle
of a neighbouring ray to their own; around a concave rim, a few are compared with every triangle.
Others, such as those of membranes that occlude themselves, are cast by Open3D, which takes a fifth
of a second to load.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.camera.intrinsics import DepthCamera
from bubbleviz.membrane import (
    MembraneMesh,
    TriangleScene,
    area_vectors,
    faces_from,
    triangles_across,
)

if TYPE_CHECKING:
    from bubbleviz.result import Estimate, Patch


_WALK = 4  # triangles that a ray may walk over; it is cast again before more are needed
_LONG_WALK = 64  # the same where it is not cast again: more than there are across a dent

_AT_ONCE = 2**15  # rays, so that what is gathered for them fits the processor's cache

_MAX_SEARCHED = 500  # rays compared with every triangle; 5,000 would take as long as Open3D to load

_COARSER = 8  # a walk starts from the triangle of every 8th ray, found first

_OUTSIDE = 1e-6  # barycentric coordinate below which a ray has left its triangle
_CONVEX = 1e-9  # tolerance (a sine) of the convexity of the rim's image: rounding


@dataclass(frozen=True)
class Hits:
    ray: np.ndarray  # (k,) int, index of each ray that hits, ascending
    triangle: np.ndarray  # (k,) int, triangle it hits
    barycentric: np.ndarray  # (k, 3), coordinates of the hit on that triangle
    range_m: np.ndarray  # (k,), distance from the origin along the unit ray, m

    def of(self, some: np.ndarray) -> Hits:
        """Hits number `some` (j,)."""
        return Hits(*(getattr(self, field.name)[some] for field in fields(self)))

    def values(self, field: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """Nodal field (n, …) at the hits, (k, …), linear on the triangles (m, 3)."""
        corners = field[triangles[self.triangle]]
        values: np.ndarray = np.einsum("kc,kc...->k...", self.barycentric, corners)
        return values


class _Facets(NamedTuple):
    faces: np.ndarray  # (m, 3, 3), cross products of the corners, opposite each corner
    facet: np.ndarray  # (m, 3), their sum, twice the area vector
    offset: np.ndarray  # (m,), distance of the facet's plane times the length of that vector

    @classmethod
    def of(cls, local: np.ndarray, triangles: np.ndarray) -> _Facets:
        """Of triangles (m, 3) between nodes (n, 3) from the origin."""
        # r̂·(b×c) and its turns are the barycentric coordinates up to their sum, r̂·facet.
        faces = faces_from(local, triangles)
        facet = faces[:, 0] + faces[:, 1] + faces[:, 2]
        return cls(faces, facet, np.einsum("mj,mj->m", local[triangles[:, 0]], facet))


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
    def _single(self) -> np.ndarray:
        """Directions in single precision."""
        return self.directions.astype(np.float32)

    def cast(
        self,
        nodes: np.ndarray,  # (n, 3), current node positions in B, m
        rays: np.ndarray | None = None,  # (j,) int
        near: np.ndarray | None = None,  # as of `first`
    ) -> Hits:
        """Nearest hit of every ray (or of those numbered by `rays`) on the mesh with `nodes`."""
        return self.hits_on(nodes, self.first(nodes, rays, near), rays)

    def hits_on(self, nodes: np.ndarray, first: np.ndarray, rays: np.ndarray | None = None) -> Hits:
        """As `cast`, if the triangle that each ray meets is known, as from `first`."""
        hit = np.flatnonzero(first >= 0)
        ray = hit if rays is None else np.asarray(rays)[hit]
        # in double precision, on the triangle that single precision found
        return self._hits_on_planes(self._facets(nodes), ray, first[hit])

    def first(
        self,
        nodes: np.ndarray,
        rays: np.ndarray | None = None,
        near: np.ndarray | None = None,  # (k,) int, as found for nodes close to these
    ) -> np.ndarray:
        """Triangle that each ray (or each of some) meets first, (k,); −1 where it meets none."""
        local = nodes - self.origin
        faces, some = faces_from(local, self.triangles), slice(None) if rays is None else rays
        ray = self._single[some]
        if self._is_facing(local, faces, some):
            walked = self._walked_first(local, faces, ray, near)
            if walked is not None:
                return walked
        # nodes are moved by −origin before single precision sees them: all rays start at zero
        found = TriangleScene(local, self._indices).cast(np.hstack([np.zeros_like(ray), ray]))
        return np.where(np.isfinite(found.distance), found.triangle, -1)

    def _walked_first(
        self, local: np.ndarray, faces: np.ndarray, ray: np.ndarray, near: np.ndarray | None
    ) -> np.ndarray | None:
        """As `first`, for triangles that all face the origin; None: the rays have to be cast."""
        single, convex = faces.astype(np.float32), self._has_convex_rim(local, faces)
        if near is None and not convex:
            return None
        if near is None:
            there, arrived = self._walked_to(single, ray)
        else:
            there, arrived = self._walked(single, ray, np.maximum(near, 0), len(faces))
        stopped = np.flatnonzero(~arrived)
        if not convex and len(stopped):  # at the rim, beyond which they may meet the mesh
            if len(stopped) > _MAX_SEARCHED:
                return None
            there[stopped], arrived[stopped] = _searched(single, ray[stopped])
        return np.where(arrived, there, -1)

    def _is_facing(self, local: np.ndarray, faces: np.ndarray, rays: slice | np.ndarray) -> bool:
        """Whether all triangles face the rays' origin: none then hides its neighbours."""
        axis = local.mean(axis=0)
        facing = np.einsum("mj,mj->m", local[self.triangles[:, 0]], faces[:, 0]) > 0.0
        before = (local @ axis > 0.0).all() and (self.directions[rays] @ axis > 0.0).all()
        return bool(facing.all() and before)

    def _has_convex_rim(self, local: np.ndarray, faces: np.ndarray) -> bool:
        """Whether the image of the rim is convex: straight walks then stay on the mesh."""
        sides = faces[self._across < 0]
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        inside = sides @ (local / np.linalg.norm(local, axis=1, keepdims=True)).T
        return bool((inside > -_CONVEX).all())

    def _walked_to(self, faces: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Triangle (j,) of each of rays (j, 3), and whether the ray hits it.

        For a mesh without self-occlusion.
        """
        start = np.zeros(len(ray), int)
        if len(ray) > _COARSER:
            start = self._walked_to(faces, ray[::_COARSER])[0].repeat(_COARSER)[: len(ray)]
        return self._walked(faces, ray, start, len(faces))

    def ranges(self, nodes: np.ndarray, rays: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """Ranges (j,) of some rays, each walking to its triangle from one nearby.

        On a surface without folds the result of `cast`, in a fraction of the time.

        Parameters
        ----------
        nodes : (n, 3) array
        rays, triangle : (j,) int array
            A triangle of −1 is none.

        Returns
        -------
        (j,) array
            m; NaN where there is no triangle, and where the ray leaves the mesh.
        """
        faces, facet, offset = self._facets(nodes)
        single = faces.astype(np.float32)
        there, arrived = self._walked(single, self._single[rays], triangle, _LONG_WALK)
        along = np.einsum("rj,rj->r", facet.take(there, axis=0), self.directions.take(rays, axis=0))
        return np.where(arrived, offset[there] / along, np.nan)

    def _walked(
        self, faces: np.ndarray, ray: np.ndarray, triangle: np.ndarray, most: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Triangle (j,) of each ray after a walk over at most `most`, and whether the ray hits it.

        Faces and rays (j, 3) are in single precision.
        """
        there, arrived = triangle.copy(), triangle >= 0
        for some in _slices(len(ray)):
            self._walk(faces, ray[some], there[some], arrived[some], most)
        return there, arrived

    def _walk(
        self,
        faces: np.ndarray,
        ray: np.ndarray,
        there: np.ndarray,
        arrived: np.ndarray,
        most: int,
    ) -> None:
        """Replace `there` by the triangle after the walk; clear `arrived` where the ray misses."""
        walking = np.flatnonzero(arrived)
        for _ in range(most):
            current = faces.take(there[walking], axis=0)
            volumes = np.einsum("rkj,rj->kr", current, ray[walking])
            lowest = np.minimum(np.minimum(volumes[0], volumes[1]), volumes[2])
            leaving = np.flatnonzero(lowest < -_OUTSIDE * volumes.sum(axis=0))
            walking, out = walking[leaving], volumes[:, leaving].argmin(axis=0)
            following = self._across[there[walking], out]
            arrived[walking[following < 0]] = False
            walking, following = walking[following >= 0], following[following >= 0]
            if not len(walking):
                return
            there[walking] = following
        arrived[walking] = False

    @cached_property
    def _across(self) -> np.ndarray:
        return triangles_across(self.triangles)

    def recast(self, nodes: np.ndarray, hits: Hits) -> Hits:
        """Hits of the same rays after a small motion of the nodes: each walks to its triangle.

        After `_WALK` triangles, the plane of the last one is hit.
        """
        facets = self._facets(nodes)
        single = facets.faces.astype(np.float32)
        there, _ = self._walked(single, self._single[hits.ray], hits.triangle, _WALK)
        return self._hits_on_planes(facets, hits.ray, there)

    def slopes(self, nodes: np.ndarray, hits: Hits) -> np.ndarray:
        """m/(r̂·m) of the hit facets, (k, 3): derivative of the range by their motion in B."""
        facet = area_vectors(nodes, self.triangles)[hits.triangle]
        along = np.einsum("ij,ij->i", facet, self.directions[hits.ray])
        return facet / along[:, None]

    def jacobian(self, nodes: np.ndarray, hits: Hits, directions: np.ndarray) -> sparse.csr_array:
        """D of Eq. 20: derivative of the ranges by motions of the nodes along directions (n, 3).

        Its coefficients are b_i (n_i·m)/(r̂·m) with the facet's unit normal m. Eq. 19 has b_i (r̂·n̂)
        instead, the projection of the motion on the ray, which is not the derivative of the range.

        Returns
        -------
        (k, n) sparse array
        """
        corners = self.triangles[hits.triangle]
        along = np.einsum("kij,kj->ki", directions[corners], self.slopes(nodes, hits))
        return sparse_rows(hits.barycentric * along, corners, len(nodes))

    def _facets(self, nodes: np.ndarray) -> _Facets:
        return _Facets.of(nodes - self.origin, self.triangles)

    def _hits_on_planes(self, facets: _Facets, ray: np.ndarray, triangle: np.ndarray) -> Hits:
        """Hits of rays (k,) on the planes of triangles (k,)."""
        barycentric, range_m = np.empty((len(ray), 3)), np.empty(len(ray))
        for some in _slices(len(ray)):
            faces = facets.faces.take(triangle[some], axis=0)
            volumes = np.einsum("rkj,rj->rk", faces, self.directions.take(ray[some], axis=0))
            along = volumes[:, 0] + volumes[:, 1] + volumes[:, 2]
            np.divide(volumes, along[:, None], out=barycentric[some])
            np.divide(facets.offset[triangle[some]], along, out=range_m[some])
        return Hits(ray, triangle, barycentric, range_m)


def _searched(faces: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangle (j,) that each of rays (j, 3) meets, and whether it meets one; tries all of them."""
    there, arrived = np.zeros(len(ray), int), np.zeros(len(ray), bool)
    for some in _slices(len(ray), _AT_ONCE // len(faces) + 1):
        volumes = np.einsum("tkj,rj->krt", faces, ray[some])
        inside = volumes.min(axis=0) + _OUTSIDE * volumes.sum(axis=0)
        there[some], arrived[some] = inside.argmax(axis=1), inside.max(axis=1) >= 0.0
    return there, arrived


def _slices(rays: int, length: int = _AT_ONCE) -> list[slice]:
    return [slice(start, start + length) for start in range(0, rays, length)]


def sparse_rows(values: np.ndarray, columns: np.ndarray, count: int) -> sparse.csr_array:
    """Sparse matrix (k, count) from the values and columns (k, j) of its rows."""
    starts = np.arange(0, values.size + 1, values.shape[1], dtype=columns.dtype)
    return sparse.csr_array((values.ravel(), columns.ravel(), starts), (len(values), count))


def vector_columns(triangles: np.ndarray) -> np.ndarray:
    """Columns (m, 9) int32 of the nodes of triangles in a matrix with three for each node."""
    columns = 3 * triangles[:, :, None] + np.arange(3)
    return columns.reshape(-1, 9).astype(np.int32)  # as SciPy keeps them


# The membrane as the camera sees it, at full resolution.


class MembraneView:
    """Renders ranges and nodal fields of the deformed membrane into the camera's image.

    Displacements are those that `MembraneMesh.deformed` takes.
    """

    def __init__(self, camera: DepthCamera, mesh: MembraneMesh) -> None:
        self.camera, self.mesh = camera, mesh
        self.shape = (camera.intrinsics.height, camera.intrinsics.width)
        self._caster = RayCaster(camera.center, camera.directions, mesh.triangles)

    def hits(self, displacement_m: np.ndarray, pixels: np.ndarray | None = None) -> Hits:
        """Where the rays of all pixels, or of those with flat indices (k,), meet the membrane."""
        near = self._near if pixels is None else self._near[pixels]
        return self._caster.cast(self.mesh.deformed(displacement_m), pixels, near)

    @cached_property
    def _near(self) -> np.ndarray:
        """Triangle that each pixel or, for one that sees none, a pixel nearby sees at rest."""
        known = np.flatnonzero(self.at_rest >= 0)
        if not len(known):
            return self.at_rest
        i, count = np.arange(len(self.at_rest)), np.cumsum(self.at_rest >= 0)
        before, after = known[np.maximum(count - 1, 0)], known[np.minimum(count, len(known) - 1)]
        return self.at_rest[np.where(np.abs(after - i) < np.abs(i - before), after, before)]

    @cached_property
    def at_rest(self) -> np.ndarray:
        """Triangle that each pixel sees at rest, (H·W,) int32; −1 for none."""
        return self._caster.first(self.mesh.nodes).astype(np.int32)

    def ranges(self, displacement_m: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Modelled ranges (k,) of pixels with flat indices (k,), m; NaN where they miss.

        Fast: each ray walks from the triangle that it hits at rest.
        """
        nodes = self.mesh.deformed(displacement_m)
        return self._caster.ranges(nodes, pixels, self.at_rest[pixels])

    def range_image(self, displacement_m: np.ndarray) -> np.ndarray:
        """Modelled range (H, W) in m; NaN where a ray misses the membrane."""
        hits = self.hits(displacement_m)
        image = np.full(self.shape, np.nan)
        image.ravel()[hits.ray] = hits.range_m
        return image

    @cached_property
    def rest_range(self) -> np.ndarray:
        """Range (H, W) of the membrane at rest, m."""
        return self.range_image(np.zeros(len(self.mesh.nodes)))

    def patch_pixels(self, estimate: Estimate, patch: Patch, level: float = 0.0) -> np.ndarray:
        """Pixels (H, W) that see where a patch exceeds a level."""
        mesh, estimate, levels = patch.finest(self.mesh, estimate)
        view = self if mesh is self.mesh else MembraneView(self.camera, mesh)
        return view.above(view.motion_seen(estimate), levels, level)

    def motion_seen(self, estimate: Estimate) -> np.ndarray:
        """Motion of an estimate relative to the camera, m, which may have been moved."""
        camera = self.camera.displaced(estimate)
        if camera is self.camera:
            return estimate.motion_m
        motion: np.ndarray = estimate.motion_m - (camera.center - self.camera.center)
        return motion

    def above(self, displacement_m: np.ndarray, field: np.ndarray, level: float) -> np.ndarray:
        """Pixels (H, W) that see a part of the membrane where a nodal field exceeds a level.

        Only the triangles that reach the level are drawn: a patch is pushed towards the camera, so
        that no other part of the membrane hides it. Lens distortion is exact at the nodes and
        linear between them.
        """
        mask, mesh = np.zeros(self.shape, bool), self.mesh
        triangles = np.flatnonzero((field > level).take(mesh.corners).any(axis=0))
        reaching = mesh.corners.take(triangles, axis=1)
        if not reaching.size:
            return mask
        met = np.zeros(len(mesh.nodes), bool)
        met[reaching] = True
        nodes, corners = np.flatnonzero(met), (np.cumsum(met) - 1)[reaching]
        seen = self.camera.local(mesh.deformed(displacement_m)[nodes])
        places = np.ones((len(nodes), 3))
        places[:, :2] = self.camera.intrinsics.project(seen)
        # times (column, row, 1): a place's barycentric coordinates up to a positive factor
        sides = faces_from(places, corners.T).transpose(1, 0, 2)
        sides *= np.sign(np.einsum("mj,mj->m", places[corners[0]], sides[0]))[:, None]
        # divided by depth, a field that is linear on a triangle is linear in the image
        excess = ((field[nodes] - level) / seen[:, 2])[corners]
        bounds = np.concatenate([sides, np.einsum("km,kmj->mj", excess, sides)[None]])
        rows = places[corners, 1]
        _fill(mask, bounds, np.ceil(rows.min(axis=0)), np.floor(rows.max(axis=0)))
        return mask


def _fill(
    mask: np.ndarray,  # (H, W) bool
    # (k, m, 3), an area is where all k products with (column, row, 1) are positive
    bounds: np.ndarray,
    # first, last: (m,), its rows
    first: np.ndarray,
    last: np.ndarray,
) -> None:
    """Set the pixels of some convex areas, by the span of columns in each of their rows."""
    height, width = mask.shape
    first, last = first.clip(0, height).astype(int), last.clip(-1, height - 1).astype(int)
    count = np.maximum(last - first + 1, 0) * bounds.any(axis=(0, 2))
    area = np.repeat(np.arange(len(count)), count)
    row = np.arange(len(area)) + np.repeat(first - np.cumsum(count) + count, count)
    slope, across, offset = bounds.transpose(2, 0, 1).take(area, axis=2)
    here = across * row + offset
    with np.errstate(divide="ignore", invalid="ignore"):
        end = -here / slope
    # parallel to the row: all of it, or nothing
    nothing = (slope == 0.0) & (here < 0.0)
    left = np.where(slope > 0.0, end, np.where(nothing, width, -1.0)).max(axis=0)
    right = np.where(slope < 0.0, end, width).min(axis=0)
    left = np.ceil(np.minimum(np.maximum(left, 0), width))  # `clip` takes three times as long
    right = np.floor(np.minimum(np.maximum(right, -1), width - 1)) + 1
    some = left < right
    if not some.any():
        return
    row, left, right = row[some], left[some].astype(int), right[some].astype(int)
    top, west = row.min(), left.min()
    box = mask[top : row.max() + 1, west : right.max()]
    wide = box.shape[1] + 1
    starts, stops = (
        np.bincount((row - top) * wide + column - west, minlength=len(box) * wide)
        for column in (left, right)
    )
    box |= np.cumsum(starts - stops).reshape(-1, wide)[:, :-1] > 0
