"""The part of a mesh around a set of nodes: neighbours, smoothing, distance to a contour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.membrane.mesh import MembraneMesh


@dataclass(frozen=True)
class Region:
    """The part of the mesh around the contact, with arrays per node of that part.

    Attributes
    ----------
    index : (k,) int array
        Its nodes in the mesh.
    points : (k, 3) array
    ring : (k, k) sparse array
        Pattern of each node with its neighbours.
    step : (k, k) sparse array
        One step of a random walk to a neighbour.
    triangles : (t, 3) int array
        Those with all corners in the part, in its numbering.
    open : (k,) bool array
        Nodes with neighbours outside the part, or on the rim.
    """

    index: np.ndarray
    points: np.ndarray
    ring: sparse.csr_array
    step: sparse.csr_array
    triangles: np.ndarray
    open: np.ndarray

    def maximum(self, field: np.ndarray) -> np.ndarray:
        """Largest value among a node and its neighbours."""
        highest: np.ndarray = np.maximum.reduceat(field[self.ring.indices], self.ring.indptr[:-1])
        return highest

    def touches(self, mask: np.ndarray) -> np.ndarray:
        """Nodes in or next to a set of nodes."""
        return (self.ring @ mask.astype(float)) > 0.0

    def any_in_part(self, mask: np.ndarray, flag: np.ndarray) -> np.ndarray:
        """Nodes of a set whose connected part holds a flagged node."""
        count, part = connected_parts(self.ring, mask)
        held = np.bincount(part, flag[mask], minlength=count) > 0
        found = mask.copy()
        found[mask] = held[part]
        return found


def neighbourhoods(mesh: MembraneMesh) -> sparse.csr_array:
    """Pattern (n, n) of ones for each node with itself and its neighbours."""
    a, b = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
    count = len(mesh.nodes)
    pairs = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(count, count))
    pattern = sparse.csr_array(pairs + pairs.T + sparse.eye_array(count))
    pattern.data[:] = 1.0
    return pattern


def among(pattern: sparse.csr_array, mask: np.ndarray) -> sparse.csr_array:
    """Pattern (k, k) of ones between the k nodes of a set, mask (n,) of the pattern's (n, n).

    SciPy's own indexing takes several times as long on a mesh this small.
    """
    kept = mask[pattern.indices] & np.repeat(mask, np.diff(pattern.indptr))
    before = np.append(0, np.cumsum(kept))
    starts = np.append(0, before[pattern.indptr[1:][mask]])
    indices = (np.cumsum(mask) - 1)[pattern.indices[kept]]
    size = len(starts) - 1
    return sparse.csr_array((np.ones(len(indices)), indices, starts), shape=(size, size))


def connected_parts(ring: sparse.csr_array, mask: np.ndarray) -> tuple[int, np.ndarray]:
    """Number of connected parts of a set of nodes, and the part of each of its nodes."""
    return connected_components(among(ring, mask), connection="strong")  # it is symmetric


def contour_points(region: Region, field: np.ndarray) -> np.ndarray:
    """Points on the zero contour of a nodal field: its cuts of the edges and half way between."""
    inside = field > 0.0
    count = inside[region.triangles].sum(axis=1)
    cut = region.triangles[(count == 1) | (count == 2)]
    # Turn each cut triangle so that its first corner is the one alone on its side.
    side = inside[cut]
    alone = np.argmax(side == (side.sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(cut))
    a, b, c = (cut[rows, (alone + k) % 3] for k in range(3))
    tb = field[a] / (field[a] - field[b])
    tc = field[a] / (field[a] - field[c])
    x = region.points
    one = x[a] + tb[:, None] * (x[b] - x[a])
    two = x[a] + tc[:, None] * (x[c] - x[a])
    return np.concatenate([one, 0.5 * (one + two)])
