"""The part of a mesh around a set of nodes: neighbours, smoothing, distance to a contour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane.level_line import level_line
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.mesh_graph import grown


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
        """The part that a set of nodes (n,) bool is."""
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
        """Largest value within some rings of a node, in proportion between whole numbers."""
        for _ in range(int(rings)):
            field = field.take(self.rings).max(axis=0)
        return field + rings % 1.0 * (field.take(self.rings).max(axis=0) - field)

    def touches(self, mask: np.ndarray) -> np.ndarray:
        """Nodes in or next to a set of nodes."""
        return grown(self.rings, mask)

    def any_in_part(self, mask: np.ndarray, flag: np.ndarray) -> np.ndarray:
        """Nodes of a set whose connected part holds a flagged node."""
        found, more = mask & flag, True
        while more:
            wider = mask & self.touches(found)
            more, found = bool(np.count_nonzero(wider) > np.count_nonzero(found)), wider
        return found


def contour_points(region: Region, field: np.ndarray) -> np.ndarray:
    """Points on the zero contour of a nodal field: its cuts of the edges and half way between."""
    pieces = level_line(region.points, region.corners, field)
    return np.concatenate([pieces[:, 0], 0.5 * (pieces[:, 0] + pieces[:, 1])])
