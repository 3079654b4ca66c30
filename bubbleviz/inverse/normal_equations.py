"""Normal equations of the range residuals: Q = DᵀWD and Dᵀ W (d̃ − d0) (Eq. 21).

The paper's f = 2Dᵀd0 should read 2Dᵀ(d0 − d̃). A ray touches the three nodes of one triangle, so Q
has the pattern of the stiffness matrix whatever the shape, and only its values ever change.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy import sparse

from bubbleviz.camera.observer import Linearisation, Observation
from bubbleviz.membrane.mesh import MembraneMesh

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
"""Corners of a triangle in the order of `Linearisation.products`."""


class NormalEquations:
    """Assembles Q and its right-hand side on the free nodes of a mesh.

    Parameters
    ----------
    mesh : MembraneMesh
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        self._free, self._nodes, n = mesh.free, len(mesh.nodes), len(mesh.free)
        number = np.full(self._nodes, -1)
        number[self._free] = np.arange(n)
        ends = number[mesh.triangles][:, _PAIRS]  # (m, 6, 2)
        low, high = ends.min(axis=2), ends.max(axis=2)
        pairs, places = np.unique(np.where(low < 0, n * n, low * n + high), return_inverse=True)
        self._places = places.reshape(-1, len(_PAIRS))
        """Where each pair of corners of each triangle goes among the pairs of nodes, (m, 6)."""
        pairs = pairs[pairs < n * n]  # the others, last, have an end on the rim
        self._pairs = len(pairs)
        row, column = np.divmod(pairs, n)
        numbered = sparse.coo_array((np.arange(1.0, len(pairs) + 1.0), (row, column)), shape=(n, n))
        self._pattern = (numbered + sparse.triu(numbered, 1).T).tocsr()
        self._pair_of_entry = self._pattern.data.astype(int) - 1

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
        products = weight[:, None] * linear.products
        places = self._places[hits.triangle].ravel()
        sums = np.bincount(places, products.ravel(), minlength=self._pairs)
        Q = copy(self._pattern)  # SciPy's own constructor checks indices that never change
        Q.data = sums[self._pair_of_entry]
        pull = weight * (observation.residual_m[hits.ray] - linear.offset_m)
        pulls = pull[:, None] * hits.sensitivity
        g = np.bincount(linear.nodes.ravel(), pulls.ravel(), minlength=self._nodes)
        return Q, g[self._free]
