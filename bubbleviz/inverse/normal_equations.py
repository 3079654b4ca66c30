"""Normal equations of the range residuals: Q = DᵀWD and Dᵀ W (d̃ − d0) (Eq. 21).

The paper's f = 2Dᵀd0 should read 2Dᵀ(d0 − d̃). A ray touches the three nodes of one triangle, so Q
has the pattern of the stiffness matrix whatever the shape, and only its values ever change.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.camera.observer import Linearisation, Observation
from bubbleviz.membrane.mesh import MembraneMesh

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


class NormalEquations:
    """Assembles Q and its right-hand side on the free nodes of a mesh.

    Parameters
    ----------
    mesh : MembraneMesh
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        self._triangles = mesh.triangles
        self._free = mesh.free
        self._nodes = len(mesh.nodes)
        number = np.full(self._nodes, -1)
        number[self._free] = np.arange(len(self._free))
        # Entry e of Q sums the triangle values listed in row e of `_gather`.
        rows, cols, source = [], [], []
        corners = number[mesh.triangles]
        count = len(corners)
        for k, (i, j) in enumerate(_PAIRS):
            for a, b in {(i, j), (j, i)}:
                rows.append(corners[:, a])
                cols.append(corners[:, b])
                source.append(k * count + np.arange(count))
        row, col, src = map(np.concatenate, (rows, cols, source))
        inside = (row >= 0) & (col >= 0)
        row, col, src = row[inside], col[inside], src[inside]
        n = len(self._free)
        key, entry = np.unique(row * n + col, return_inverse=True)
        self._gather = sparse.csr_array(
            (np.ones(len(src)), (entry, src)), shape=(len(key), len(_PAIRS) * count)
        )
        self._indices = (key % n).astype(np.int32)
        self._indptr = np.searchsorted(key // n, np.arange(n + 1)).astype(np.int32)

    def assemble(
        self, observation: Observation, linear: Linearisation
    ) -> tuple[sparse.csr_array, np.ndarray]:
        """Q (n_free×n_free, 1/m²) and Dᵀ W e (n_free, 1/m) of one frame.

        Returns
        -------
        Q : sparse array
            Always with the same pattern.
        g : (n_free,) array
        """
        hits = linear.hits
        weight = observation.weight[hits.ray]
        residual = observation.residual_m[hits.ray] - linear.offset_m
        weight = np.where(np.isfinite(residual), weight, 0.0)
        residual = np.where(weight > 0.0, residual, 0.0)
        weighted = hits.sensitivity * weight[:, None]
        count = len(self._triangles)
        per_triangle = np.concatenate(
            [
                np.bincount(hits.triangle, weighted[:, i] * hits.sensitivity[:, j], count)
                for i, j in _PAIRS
            ]
        )
        n = len(self._free)
        Q = sparse.csr_array((self._gather @ per_triangle, self._indices, self._indptr), (n, n))
        weighted *= residual[:, None]
        g = np.zeros(self._nodes)
        for k in range(3):
            sums = np.bincount(hits.triangle, weighted[:, k], count)
            g += np.bincount(self._triangles[:, k], sums, self._nodes)
        return Q, g[self._free]
