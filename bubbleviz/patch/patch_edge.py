"""The edge of the contact patch, below the blur of the estimated contact pressure.

Noise and prior leave the estimate p̂ blurred by a Gaussian-like kernel of known width ℓ
(`resolution.resolution_m`). The membrane lies on a flat or convex object with at least the gauge
pressure, and on the edges of a flat face it carries a line load on top, so that across the true
edge p̂ is a blurred step of height b (the interior) plus a blurred ridge. The contour at half the
height of a step therefore lies on the edge where the interior is as high as the local maximum m
(a ball), and ever further outside it, up to about ℓ √(2 ln 1/α), where the ridge is all there is
(a sharp box).
The contour is drawn there, smoothed over ℓ without shrinking it, and moved in by that much.
"""

from __future__ import annotations

from math import ceil, erf, log, sqrt

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.patch.mesh_region import Region, among, contour_points, neighbourhoods

_INSET = 0.2  # how far, in mesh edges, the half height of p̂ lies inside that of the blurred p_c
_FLOOR = 0.5  # fraction of the gauge pressure below which nothing is contact
_HOLE = 2.0  # deepest hole, in ℓ, in which missing gauge pressure could go unnoticed
_PROFILE = 4.0  # length along the contour, in ℓ, over which its profile is averaged


class PatchEdge:
    """Finds the edge of the patch in an estimated contact pressure.

    Parameters
    ----------
    mesh : MembraneMesh
    resolution_m : float
        ℓ, see `resolution.resolution_m`.

    Attributes
    ----------
    resolution : float
        ℓ, or half a mesh edge where that is more, m.
    ring : (n, n) sparse array
        Pattern of each node with its neighbours.
    """

    def __init__(self, mesh: MembraneMesh, resolution_m: float) -> None:
        self.mesh = mesh
        a, b = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
        self._edge = float(np.linalg.norm(mesh.nodes[a] - mesh.nodes[b], axis=1).mean())
        # Below half an edge it is the mesh that blurs.
        self.resolution = max(resolution_m, 0.5 * self._edge)
        self.ring = neighbourhoods(mesh)
        self._degree = np.diff(self.ring.indptr) - 1
        self._rings = ceil(_HOLE * self.resolution / self._edge) + 2
        self._far = _HOLE * self.resolution + self._edge
        # One-ring maximum beside a blurred straight step, as a fraction of the step.
        edge = self._edge / self.resolution
        self._beside = 0.5 * (1.0 + erf(edge / sqrt(2.0)))
        # α is half the step as a fraction of that maximum, drawn `_INSET` further out.
        self._level = (0.5 - _INSET * edge / sqrt(2.0 * np.pi)) / self._beside

    def level_set(self, contact_pressure_pa: np.ndarray, gauge_pressure_pa: float) -> np.ndarray:
        """Signed distance ψ (n,) to the edge in m, positive inside, to be interpolated linearly."""
        psi = np.full(len(self.mesh.nodes), -self._far)
        floor = _FLOOR * gauge_pressure_pa
        if not np.any(contact_pressure_pa > floor):
            return psi
        region = self._around(contact_pressure_pa > floor)
        p = contact_pressure_pa[region.index]
        psi[region.index] = self._edge_distance(region, p, floor)
        return psi

    def _edge_distance(self, region: Region, p: np.ndarray, floor: float) -> np.ndarray:
        peak = region.maximum(p)
        distance = self._distance(region, _contour(region, p, peak, self._level, floor))
        filled = self._fill_holes(region, distance)
        if filled is not distance:
            distance = self._distance(region, filled)
        reach = 3.0 * self.resolution
        before = np.clip(distance, -reach, reach)
        smooth = self._smooth(region, before, self.resolution)
        distance = self._distance(region, smooth)
        distance -= self._dilation(region, p, peak, distance, before)
        return distance

    def _dilation(
        self,
        region: Region,
        p: np.ndarray,
        peak: np.ndarray,
        distance: np.ndarray,
        before: np.ndarray,
    ) -> np.ndarray:
        """How far outside the edge the contour lies, m: ℓ √(2 ln 1/α) (1 − b/m : b/m of a step).

        The profile is averaged along the contour; so is what the smoothing took off, given back.
        """
        near = np.abs(distance) < self.resolution
        deep = np.clip(distance / self.resolution - 1.0, 0.0, 1.0)
        columns = [near * peak, near * (before - distance), near, deep * p, deep]
        sums = self._smooth(region, np.stack(columns, axis=1), _PROFILE * self.resolution)
        beside = np.maximum(sums[:, 2], 1e-9)
        maximum = np.maximum(sums[:, 0] / beside, 1e-9)
        shrunk = sums[:, 1] / beside
        # Where no interior is in sight, a step.
        interior = (sums[:, 3] + 1e-6 * maximum / self._beside) / (sums[:, 4] + 1e-6)
        step = self._beside * interior / maximum
        ridge = self.resolution * sqrt(2.0 * log(1.0 / self._level))
        dilation: np.ndarray = ridge * np.clip(1.0 - step, -0.5, 1.0) - shrunk
        return dilation

    def _fill_holes(self, region: Region, distance: np.ndarray) -> np.ndarray:
        """Give to the patch the holes too small to be seen."""
        outside = distance <= 0.0
        seen = region.open | (distance < -_HOLE * self.resolution)
        holes = outside & ~region.any_in_part(outside, seen)
        return np.where(holes, 0.5 * self._edge, distance) if holes.any() else distance

    def _smooth(self, region: Region, field: np.ndarray, length: float) -> np.ndarray:
        """Gaussian smoothing of standard deviation `length` by random walks on the mesh."""
        variance = 2.0 * (length / self._edge) ** 2
        steps = ceil(1.25 * variance)  # of at most 0.8 of a step: no mode turns negative
        share = variance / steps
        for _ in range(steps):
            field = field + share * (region.step @ field - field)
        return field

    def _distance(self, region: Region, field: np.ndarray) -> np.ndarray:
        """Signed distance to the zero contour of a nodal field, m."""
        points = contour_points(region, field)
        if len(points) == 0:
            return np.where(field > 0.0, self._far, -self._far)
        distance, _ = cKDTree(points).query(region.points)
        return np.where(field > 0.0, distance, -distance)

    def _around(self, mask: np.ndarray) -> Region:
        """The part of the mesh within a few rings of a set of nodes."""
        for _ in range(self._rings):
            mask = (self.ring @ mask.astype(float)) > 0.0
        index = np.flatnonzero(mask)
        ring = among(self.ring, mask)
        neighbours = np.diff(ring.indptr) - 1
        rows = np.repeat(np.arange(len(index)), neighbours + 1)
        weight = np.where(rows == ring.indices, 0.0, 1.0 / np.maximum(neighbours, 1)[rows])
        number = np.full(len(mask), -1)
        number[index] = np.arange(len(index))
        triangles = number[self.mesh.triangles[mask[self.mesh.triangles].all(axis=1)]]
        return Region(
            index=index,
            points=self.mesh.nodes[index],
            ring=ring,
            step=sparse.csr_array((weight, ring.indices, ring.indptr), ring.shape),
            triangles=triangles,
            open=(neighbours < self._degree[index]) | self.mesh.rim[index],
        )


def _contour(
    region: Region, p: np.ndarray, peak: np.ndarray, fraction: float, floor: float
) -> np.ndarray:
    """Field that changes sign at α of the local maximum, where that is reached from outside.

    Lower ground behind a ridge is not reached from outside: it is the interior of the patch.
    """
    level = np.maximum(floor, fraction * peak)
    above = p > floor
    flank = above & (p < level)
    outer = region.any_in_part(flank, region.touches(~above))
    inner = above & ~outer
    field = np.where(inner, np.maximum(p - level, 0.5 * floor), p - level)
    field /= np.maximum(peak, 2.0 * floor)
    return field
