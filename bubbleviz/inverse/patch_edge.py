"""The edge of the contact patch, below the blur of the estimated contact pressure.

Noise and prior leave the estimate p̂ blurred by a Gaussian-like kernel of known width ℓ
(`resolution.resolution_m`), the mesh by half an edge. The pressure on a flat or convex object is at
least the gauge pressure, with an additional line load on the edges of a flat face, so that across
the true edge p̂ is a blurred step of height b (the interior) plus a blurred ridge. The contour at
half the height m inside the edge lies on the edge if the interior is as high (a ball), and up to
about ℓ √(2 ln 2) outside it if there is only the ridge (a sharp box). m is a mean over nodes
inside, mostly those without a neighbour outside: nodes at the edge carry only the load of the part
of their cell in contact, and the maximum would be noise.
The contour is smoothed over ℓ, or less in a narrow patch, and moved inwards by that distance.
Corrections compensate shrinkage by smoothing and blur where the contour is curved, and widening by
blur of contacts that are hardly wider than ℓ.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np
from scipy.spatial.distance import cdist

from bubbleviz.inverse.resolution import MESH_BLUR
from bubbleviz.membrane import MembraneMesh, grown, level_line

# The part of a mesh around a set of nodes: neighbours, smoothing, distance to a contour.


@dataclass(frozen=True)
class Region:
    """The part of the mesh around the contact, with arrays per node of that part.

    Attributes
    ----------
    index : (k,) int array
        Its nodes in the mesh.
    points : (k, 3) array
    rings : (d, k) int array
        Each node and its neighbours in the part: a column a node, filled up with the node.
    neighbours : (k,) int array
        Number of those neighbours.
    corners : (3, t) int array
        Triangles with all corners in the part, in its numbering.
    open : (k,) bool array
        Nodes with neighbours outside the part, or on the rim.
    """

    index: np.ndarray
    points: np.ndarray
    rings: np.ndarray
    neighbours: np.ndarray
    corners: np.ndarray
    open: np.ndarray

    @classmethod
    def of(cls, mesh: MembraneMesh, mask: np.ndarray) -> Region:
        """Region of a set of nodes (n,) bool."""
        index = np.flatnonzero(mask)
        around = mesh.rings.take(index, axis=1)
        outside = ~mask.take(around)
        number = np.cumsum(mask) - 1
        rings = np.where(outside, np.arange(len(index)), number[around])
        return cls(
            index,
            mesh.nodes[index],
            rings,
            np.count_nonzero(rings != rings[0], axis=0),
            number[mesh.corners[:, mask.take(mesh.corners).all(axis=0)]],
            outside.any(axis=0) | mesh.rim[index],
        )

    def differences(self, field: np.ndarray) -> np.ndarray:
        """Sum of the differences of a node's neighbours from it, of fields (…, k)."""
        sums: np.ndarray = field.take(self.rings, axis=-1).sum(axis=-2) - len(self.rings) * field
        return sums

    def totals(self, field: np.ndarray) -> np.ndarray:
        """Sum over each node and its neighbours, of fields (…, k)."""
        return self.differences(field) + (1 + self.neighbours) * field

    def maximum(self, field: np.ndarray, rings: float) -> np.ndarray:
        """Largest value within some rings of a node, interpolated for a fraction of a ring."""
        for _ in range(int(rings)):
            field = field.take(self.rings).max(axis=0)
        return field + rings % 1.0 * (field.take(self.rings).max(axis=0) - field)

    def touches(self, mask: np.ndarray) -> np.ndarray:
        """Nodes in or next to a set of nodes."""
        return grown(self.rings, mask)

    def any_in_part(self, mask: np.ndarray, flag: np.ndarray) -> np.ndarray:
        """Nodes of a set whose connected part contains a flagged node."""
        found, more = mask & flag, True
        while more:
            wider = mask & self.touches(found)
            more, found = bool(np.count_nonzero(wider) > np.count_nonzero(found)), wider
        return found


def contour_points(region: Region, field: np.ndarray) -> np.ndarray:
    """Points on the zero contour of a nodal field: its cuts of the edges and half way between."""
    pieces = level_line(region.points, region.corners, field)
    return np.concatenate([pieces[:, 0], 0.5 * (pieces[:, 0] + pieces[:, 1])])


_FLOOR = 0.5  # fraction of the gauge pressure below which nothing is contact
_HOLE = 2.0  # deepest hole, in ℓ, that the blur may cause in a contact without holes
_PROFILE = 4.0  # length along the contour, in ℓ, over which its profile is averaged
_INSIDE = 4
"""The weight of a node is the share of its neighbourhood inside, to this power. Chosen: of 2, 4, 8
and 16 the one with the steadiest edge in the hold of the real press."""
_INWARD = 1.75
"""Distance inside the edge, in ℓ, where a blurred step has almost its full height; at least one
mesh edge. Chosen on presses of four objects into three membranes: 2 shrinks contacts on a dome
that are too small already. On six others (`benchmarks/objects`) 1.5 is as good and 2 worse."""
_THIN = 0.5
"""Largest smoothing length over the patch's half width: more would remove small contacts. Of
presses of ten objects 0.35 to 0.7 have the same IoU to 0.01."""
_NARROW = np.array(
    [
        [0.0, 1.386, 1.483, 1.600, 1.737, 1.890, 2.057, 2.235, 2.516, 3.003],
        [0.0, 0.386, 0.283, 0.200, 0.137, 0.090, 0.057, 0.035, 0.016, 0.003],
    ]
)
"""Half width of the contour at half the height of a blurred strip, and how much of it lies outside
the strip, in ℓ. The contour says little about strips narrower than 2 ℓ: they are taken to be
narrower than their contour in the same proportion as one of 2 ℓ."""
_ROUND = 0.16
"""Largest distance, in ℓ, of the contour at half the height of a blurred disc's centre from the
disc's edge, inside: at a radius of 2.7 ℓ. For larger discs it equals the shrinkage by smoothing,
ℓ²/2 over the radius."""


class PatchEdge:
    """Finds the edge of the patch in an estimated contact pressure.

    Parameters
    ----------
    mesh : MembraneMesh
    edge_length_m : float, optional
        Mean length of the mesh's edges where there is contact; of all of them by default.
    """

    def __init__(self, mesh: MembraneMesh, edge_length_m: float | None = None) -> None:
        self.mesh = mesh
        if edge_length_m is None:
            a, b = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
            edge_length_m = float(np.linalg.norm(mesh.nodes[a] - mesh.nodes[b], axis=1).mean())
        self.edge_length_m = edge_length_m

    def blur_m(self, resolution_m: float) -> float:
        """ℓ for a resolution of the estimate, m: at least the blur by the mesh."""
        return max(resolution_m, MESH_BLUR * self.edge_length_m)

    def level_set(
        self, contact_pressure_pa: np.ndarray, gauge_pressure_pa: float, resolution_m: float
    ) -> np.ndarray:
        """Signed distance ψ (n,) to the edge in m, positive inside, to be interpolated linearly.

        Parameters
        ----------
        contact_pressure_pa : (n,) array
        gauge_pressure_pa : float
        resolution_m : float
            Of the estimate, see `resolution.resolution_m`.
        """
        blur = self.blur_m(resolution_m)
        psi = np.full(len(self.mesh.nodes), -_HOLE * blur - self.edge_length_m)
        floor = _FLOOR * gauge_pressure_pa
        if not np.any(contact_pressure_pa > floor):
            return psi
        region = self._around(
            contact_pressure_pa > floor, ceil(_HOLE * blur / self.edge_length_m) + 2
        )
        p = contact_pressure_pa[region.index]
        psi[region.index] = self._edge_distance(region, p, floor, blur)
        return psi

    def _edge_distance(
        self, region: Region, p: np.ndarray, floor: float, blur: float
    ) -> np.ndarray:
        outside = self._outside(region, p - floor, blur)
        inward = max(1.0, _INWARD * blur / self.edge_length_m)
        inside_pressure = _pressure_inside(region, p, _membership(p / floor, outside), inward)
        contour = _contour(region, p, inside_pressure, outside, floor, inward)
        distance = self._distance(region, contour, blur)
        reach = 3.0 * blur
        before = np.clip(distance, -reach, reach)
        half_width = np.maximum(region.maximum(before, reach / self.edge_length_m), 0.0)
        smooth = self._smooth(region, before, np.minimum(blur, _THIN * half_width))
        distance = self._distance(region, smooth, blur)
        distance -= self._dilation(region, p, inside_pressure, distance, before, blur)
        return distance - self._widening(half_width, blur)

    def _dilation(
        self,
        region: Region,
        p: np.ndarray,
        inside_pressure: np.ndarray,
        distance: np.ndarray,
        before: np.ndarray,
        blur: float,
    ) -> np.ndarray:
        """How far the contour lies outside the edge, m: ℓ √(2 ln 2) (1 − b/m) minus the shrinkage.

        Profile and shrinkage by smoothing are averaged along the contour.
        """
        near = np.exp(-0.5 * (distance / blur) ** 2)
        deep = np.clip(distance / blur - 1.0, 0.0, 1.0)
        fields = np.stack(
            [near * inside_pressure, near * (before - distance), near, deep * p, deep]
        )
        heights, lost, count, loads, insides = self._smooth(region, fields, _PROFILE * blur)
        count = np.maximum(count, 1e-9)
        height = np.maximum(heights / count, 1e-9)
        shrunk = lost / count
        # Without an interior nearby: a step.
        interior = (loads + 1e-6 * height) / (insides + 1e-6)
        ridge = np.maximum(1.0 - interior / height, 0.0)
        by_blur = np.clip(shrunk, -_ROUND * blur, _ROUND * blur)
        dilation: np.ndarray = blur * sqrt(2.0 * log(2.0)) * ridge - shrunk - by_blur
        return dilation

    def _widening(self, half_width: np.ndarray, blur: float) -> np.ndarray:
        """How far the contour of a narrow contact lies outside the edge, m.

        Only blur beyond that of the mesh counts: the nodes of the support end at the edge.
        """
        excess = max(sqrt(max(blur**2 - (MESH_BLUR * self.edge_length_m) ** 2, 0.0)), 1e-9)
        widening: np.ndarray = excess * np.interp(half_width / excess, *_NARROW)
        return widening

    def _outside(self, region: Region, over: np.ndarray, blur: float) -> np.ndarray:
        """Nodes (k,) bool below the floor, except in holes too small to be resolved."""
        low = over <= 0.0
        outside = region.any_in_part(low, region.open)
        if (outside == low).all():
            return low
        resolved = outside | (self._distance(region, over, blur) < -_HOLE * blur)
        return region.any_in_part(low, resolved)

    def _smooth(self, region: Region, field: np.ndarray, length: float | np.ndarray) -> np.ndarray:
        """Gaussian smoothing of fields (…, k), standard deviation `length`, by random walks.

        The length may differ between nodes, (k,).
        """
        variance = 2.0 * (length / self.edge_length_m) ** 2
        steps = ceil(1.25 * np.max(variance))  # each at most 0.8 of a step: no mode turns negative
        share = variance / steps / np.maximum(region.neighbours, 1)
        walk = np.where(region.rings != region.rings[0], share, 0.0)
        walk[0] = 1.0 - share * region.neighbours
        for _ in range(steps):
            field = np.einsum("dk,...dk->...k", walk, field.take(region.rings, axis=-1))
        return field

    def _distance(self, region: Region, field: np.ndarray, blur: float) -> np.ndarray:
        """Signed distance to the zero contour of a nodal field, m; a constant if it has none."""
        points = contour_points(region, field)
        if len(points) == 0:
            constant = _HOLE * blur + self.edge_length_m
            return np.where(field > 0.0, constant, -constant)
        distance = cdist(region.points, points).min(axis=1)  # a k-d tree is slower for so few
        return np.where(field > 0.0, distance, -distance)

    def _around(self, mask: np.ndarray, rings: int) -> Region:
        """The part of the mesh within some rings of a set of nodes."""
        for _ in range(rings):
            mask = grown(self.mesh.rings, mask)
        return Region.of(self.mesh, mask)


def _membership(share: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Degree (k,) to which nodes are inside, 0 to 1, by their pressure over the floor.

    It rises from 0 at half the floor to 1 at one and a half, so that a node at the edge does not
    change the pressure inside by a jump. Nodes of a hole caused by blur count as inside.
    """
    return np.where(outside | (share > 1.0), np.clip(share - 0.5, 0.0, 1.0), 1.0)


def _pressure_inside(region: Region, p: np.ndarray, member: np.ndarray, rings: float) -> np.ndarray:
    """Pressure (k,) inside next to each node, Pa: the largest local mean within some rings of it.

    Means are over nodes with no neighbour outside. A small contact has one such node or none, too
    few for a mean: the mean over all nodes, weighted by how far inside they are, counts as one more
    node. `member` (k,) is the degree to which each is inside.
    """
    share = region.totals(member) / (region.neighbours + 1)
    weight = member * share**_INSIDE
    inner = -region.maximum(-member, 1)
    weighed, weights, inward, count = region.totals(
        np.stack([weight * p, weight, inner * p, inner])
    )
    return region.maximum((inward + weighed / np.maximum(weights, 1e-9)) / (count + 1.0), rings)


def _contour(
    region: Region,
    p: np.ndarray,
    inside_pressure: np.ndarray,
    outside: np.ndarray,
    floor: float,
    rings: float,
) -> np.ndarray:
    """Field that changes sign at half the pressure inside, on parts connected to the outside.

    Lower pressure behind a ridge is not connected to the outside, or only through a gap in the
    ridge. Nodes more than `rings` from the outside, where a blurred step has reached its full
    height, belong to the patch.
    """
    level = np.maximum(floor, 0.5 * inside_pressure)
    flank = ~outside & (p < level) & (region.maximum(outside.astype(float), rings) > 0.5)
    outer = region.any_in_part(flank, region.touches(outside))
    field = np.where(outside | outer, p - level, np.maximum(p - level, 0.5 * floor))
    field /= np.maximum(inside_pressure, 2.0 * floor)
    return field
