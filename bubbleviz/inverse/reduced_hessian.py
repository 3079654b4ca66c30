"""The Hessian MᵀQM + λL of Eq. 24, formed only where it is asked for."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium

DENSE_LIMIT = 4_000
"""Nodes up to which the whole is formed at once, which takes n² numbers and n³ operations."""

CACHED_COLUMNS = 6_000
"""Columns kept of a larger one before those out of use are dropped."""


class ReducedHessian:
    """Model Hessian of the reference configuration, for the gas measured and estimated.

    A contact needs the columns of its own nodes and their neighbours; on a large mesh these are
    computed when first asked for and kept, as a contact moves little from frame to frame.

    Parameters
    ----------
    equilibrium : Equilibrium
    Q : (n, n) sparse array
    lambda_ : float
    """

    def __init__(self, equilibrium: Equilibrium, Q: sparse.csr_array, lambda_: float) -> None:
        self._equilibrium, self._Q = equilibrium, Q
        self._H1 = (lambda_ * equilibrium.L).tocsr()
        self._bulge_pull = Q @ equilibrium.bulge
        self._bulge_weight = float(equilibrium.bulge @ self._bulge_pull)
        self._forget()
        if len(equilibrium.A) <= DENSE_LIMIT:
            self._add(np.arange(len(equilibrium.A)))

    def block(self, nodes: np.ndarray, gas_measured: bool) -> np.ndarray:
        """Rows and columns of the given nodes (k,), (k, k)."""
        missing = nodes[self._place[nodes] < 0]
        if missing.size:
            if len(self._nodes) + missing.size > CACHED_COLUMNS:
                self._forget()
                missing = nodes
            self._add(missing)
        at = self._place[nodes]
        H = self._data[np.ix_(at, at)]
        if not gas_measured:
            # The gas law adds −b wᵀ to M: two rank-one terms (b: bulge under unit pressure).
            w = self._gas[at]
            mixed = np.outer(self._pull[at] - 0.5 * self._bulge_weight * w, w)
            H -= mixed + mixed.T
        return H

    def _forget(self) -> None:
        n = len(self._equilibrium.A)
        self._place = np.full(n, -1)
        self._nodes = np.zeros(0, int)
        self._M = np.empty((n, 0), order="F")
        self._data = np.empty((0, 0))
        self._pull, self._gas = np.zeros(0), np.zeros(0)

    def _add(self, nodes: np.ndarray) -> None:
        """Compute the columns of some more nodes."""
        n, known = len(self._place), len(self._nodes)
        total = known + len(nodes)
        unit = np.zeros((n, len(nodes)))
        unit[nodes, np.arange(len(nodes))] = 1.0
        M = self._equilibrium.response(unit, gas_measured=True)
        QM = self._Q @ M
        self._reserve(total)
        cross = self._M[:, :known].T @ QM + self._H1[self._nodes][:, nodes].toarray()
        self._data[:known, known:total], self._data[known:total, :known] = cross, cross.T
        self._data[known:total, known:total] = M.T @ QM + self._H1[nodes][:, nodes].toarray()
        if total < n:  # a complete mesh needs no columns to go on from
            self._M[:, known:total] = M
        self._place[nodes] = known + np.arange(len(nodes))
        self._nodes = np.concatenate([self._nodes, nodes])
        self._pull = np.concatenate([self._pull, M.T @ self._bulge_pull])
        self._gas = np.concatenate([self._gas, self._equilibrium.gas_response(M)])

    def _reserve(self, columns: int) -> None:
        """Make room for so many columns, by doubling: most frames add a few."""
        n, known = len(self._place), len(self._nodes)
        if columns <= len(self._data):
            return
        room = min(n, max(columns, 2 * len(self._data)))
        data = np.empty((room, room))
        data[:known, :known] = self._data[:known, :known]
        self._data = data
        if columns < n:
            M = np.empty((n, room), order="F")
            M[:, :known] = self._M[:, :known]
            self._M = M
