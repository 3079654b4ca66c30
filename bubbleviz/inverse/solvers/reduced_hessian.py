"""The Hessian MᵀQM + λL of Eq. 24: formed whole once, or on a fine mesh where it is asked for."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium
from bubbleviz.inverse.solvers.pivoting import part


class ReducedHessian:
    """Model Hessian of the reference configuration, for the gas measured and estimated.

    Parameters
    ----------
    equilibrium : Equilibrium
    Q : (n, n) sparse array
    lambda_ : float
    """

    def __init__(self, equilibrium: Equilibrium, Q: sparse.csr_array, lambda_: float) -> None:
        self._equilibrium, self._Q, self._H1 = equilibrium, Q, (lambda_ * equilibrium.L).tocsr()
        if equilibrium.inverse is None:  # too many nodes
            return
        M = equilibrium.response(np.arange(len(equilibrium.A)), gas_measured=True)
        self._measured = M.T @ (Q @ M) + self._H1.toarray()
        # The gas law adds −b wᵀ to M: two rank-one terms (b: bulge under unit pressure).
        bulge_pull = Q @ equilibrium.bulge
        self._gas = equilibrium.gas_response(M)
        self._pull = M.T @ bulge_pull - 0.5 * (equilibrium.bulge @ bulge_pull) * self._gas

    @cached_property
    def _estimated(self) -> np.ndarray:
        """The Hessian where the gas pressure is estimated too, (n, n)."""
        mixed = np.outer(self._pull, self._gas)
        mixed += mixed.T
        return np.subtract(self._measured, mixed, out=mixed)

    def block(self, nodes: np.ndarray, gas_measured: bool, scale: float = 1.0) -> np.ndarray:
        """`scale` times the rows and columns of the given nodes (k,), (k, k)."""
        if self._equilibrium.inverse is None:
            M = self._equilibrium.response(nodes, gas_measured)
            H = M.T @ (self._Q @ M) + self._H1[nodes][:, nodes].toarray()
        else:
            H = part(self._measured if gas_measured else self._estimated, nodes)
        H *= scale
        return H
