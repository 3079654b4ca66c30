"""The operators S and D of Eqs. 17–20 as sparse matrices."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.camera.raycast import Hits


def interpolation_matrix(hits: Hits, triangles: np.ndarray, nodes: int) -> sparse.csr_array:
    """S, k×n: interpolates a nodal field at the points the rays hit (Eq. 17)."""
    return _rows(hits.barycentric, hits, triangles, nodes)


def range_jacobian(hits: Hits, triangles: np.ndarray, nodes: int) -> sparse.csr_array:
    """D, k×n: derivative of the ranges with respect to the nodal displacements (Eq. 20)."""
    return _rows(hits.sensitivity, hits, triangles, nodes)


def _rows(values: np.ndarray, hits: Hits, triangles: np.ndarray, nodes: int) -> sparse.csr_array:
    starts = np.arange(0, 3 * len(values) + 1, 3)
    columns = triangles[hits.triangle].ravel()
    return sparse.csr_array((values.ravel(), columns, starts), shape=(len(values), nodes))
