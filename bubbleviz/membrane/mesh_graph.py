"""Sets of nodes on the graph of a mesh's edges, given as `MembraneMesh.rings`."""

from __future__ import annotations

import numpy as np
from scipy import sparse


def grown(rings: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Nodes (n,) bool in or next to a set of nodes."""
    wider = mask.copy()
    wider[rings.take(np.flatnonzero(mask), axis=1)] = True
    return wider


def connected_parts(rings: np.ndarray, mask: np.ndarray) -> tuple[int, np.ndarray]:
    """Number of connected parts of a set of nodes (n,) bool, and the part of each of its nodes."""
    nodes, lowest = np.flatnonzero(mask), np.arange(len(mask))
    around = rings[:, nodes]
    around = np.where(mask[around], around, nodes)
    while True:  # each node learns of the lowest one in its part, by neighbours and by that one
        lower = lowest[around].min(axis=0, initial=len(mask))
        if (lower == lowest[nodes]).all():  # `np.array_equal` takes several times as long
            break
        lowest[nodes] = lower
        lowest[nodes] = lowest[lower]
    first = nodes[lower == nodes]
    return len(first), np.searchsorted(first, lower)


def parts_with(rings: np.ndarray, some: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Connected parts of a set of nodes (n,) bool that have one of `some` of them (n,) bool."""
    count, part = connected_parts(rings, mask)
    chosen = np.bincount(part, some[mask], minlength=count) > 0.0
    kept = mask.copy()
    kept[mask] = chosen[part]
    return kept


def adjacency(rings: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Which of some nodes (k,) share an edge, (k, k) bool."""
    number = np.full(rings.shape[1], -1)
    number[nodes] = np.arange(len(nodes))
    there = number[rings[:, nodes]]
    adjacent = np.zeros((len(nodes), len(nodes)), bool)
    adjacent[there[there >= 0], np.nonzero(there >= 0)[1]] = True
    np.fill_diagonal(adjacent, False)
    return adjacent


def dense_part(matrix: sparse.csr_array, nodes: np.ndarray) -> np.ndarray:
    """Rows and columns `nodes` (k,) of a sparse matrix, (k, k).

    SciPy's own indexing takes several times as long on matrices this small.
    """
    number = np.full(matrix.shape[1], -1)
    number[nodes] = np.arange(len(nodes))
    starts = matrix.indptr[nodes]
    count = matrix.indptr[nodes + 1] - starts
    row = np.repeat(np.arange(len(nodes)), count)
    entry = np.arange(len(row)) + np.repeat(starts - np.cumsum(count) + count, count)
    column = number[matrix.indices[entry]]
    inside = column >= 0
    part = np.zeros((len(nodes), len(nodes)))
    part[row[inside], column[inside]] = matrix.data[entry[inside]]
    return part
