"""The operator D of Eq. 20 as a sparse matrix."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.camera.raycast import Hits


def range_jacobian(hits: Hits, triangles: np.ndarray, nodes: int) -> sparse.csr_array:
    """D, k×n: derivative of the ranges with respect to the nodal displacements (Eq. 20)."""
    values, columns = hits.sensitivity, triangles[hits.triangle]
    starts = np.arange(0, 3 * len(values) + 1, 3)
    return sparse.csr_array((values.ravel(), columns.ravel(), starts), shape=(len(values), nodes))
