"""The Hessian MᵀQM + λL of Eq. 24 on a fine mesh: few columns and a sparse remainder.

The camera's part MᵀQM is a very smooth kernel (two membrane solves), so its columns at landmarks
spread over the membrane determine it to far below the prior's part λL (Nyström's approximation
C W⁻¹ Cᵀ; Williams and Seeger 2001). λL is sparse. Both stay cheap as the mesh gets finer.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from bubbleviz.inverse.problem import Equilibrium
from bubbleviz.inverse.resolution import information_density, resolution_m

WITHIN = 1.5
"""No node is farther from a landmark, in widths of the estimate's response: at that wave number
the camera's part of the Hessian is far below the prior's."""

_JITTER = 1e-12
"""Relative to its trace, what keeps W positive definite in double precision."""


class LandmarkHessian:
    """Model Hessian of the reference configuration, for the gas measured and estimated.

    A landmark's column is computed when a contact first comes near it.

    Parameters
    ----------
    equilibrium : Equilibrium
    Q : (n, n) sparse array
    lambda_ : float
    within : float, optional
        Largest distance from a node to a landmark, in resolution lengths; exact with 0.

    Attributes
    ----------
    landmarks : (m,) int array
        Indices of the nodes whose columns stand for all.
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        Q: sparse.csr_array,
        lambda_: float,
        within: float = WITHIN,
    ) -> None:
        self._H1 = (lambda_ * equilibrium.L).tocsr()
        # Lengths in units of a and pressures in γ0/a make γ0 = 1.
        resolution = resolution_m(lambda_, 1.0, information_density(Q, equilibrium.A))
        nodes = equilibrium.nodes
        self.landmarks = farthest_points(nodes, within * resolution)
        self._owner = np.asarray(cKDTree(nodes[self.landmarks]).query(nodes)[1])
        self._columns = {known: _Columns(equilibrium, Q, known) for known in (True, False)}

    def block(self, nodes: np.ndarray, gas_measured: bool, scale: float = 1.0) -> LowRankQuadratic:
        """`scale` times the rows and columns of the given nodes (k,)."""
        near = self.landmarks[np.unique(self._owner[nodes])]
        C = self._columns[gas_measured].of(near)
        return LowRankQuadratic(C[nodes], C[near], self._H1[nodes][:, nodes], scale)


class LowRankQuadratic:
    """s (C W⁻¹ Cᵀ + B) with a sparse B; see `pivoting.Quadratic`.

    Parameters
    ----------
    C : (k, m) array
    W : (m, m) array
    B : (k, k) sparse array
    scale : float
        s.
    """

    def __init__(self, C: np.ndarray, W: np.ndarray, B: sparse.csr_array, scale: float) -> None:
        self._C, self._B, self._scale = C, B, scale
        self._W = 0.5 * (W + W.T)
        self._W[np.diag_indices(len(W))] += _JITTER * np.trace(W)

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return self._scale * (self._C @ self._solve_W(self._C.T @ x) + self._B @ x)

    def solve(self, inside: np.ndarray, rhs: np.ndarray) -> np.ndarray:
        """Solve with the rows and columns `inside` (Woodbury).

        Raises
        ------
        LinAlgError
            Not positive definite to working precision.
        """
        C = self._C[inside]
        try:
            factor = splu(
                self._B[inside][:, inside].tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:  # SuperLU's word for singular
            raise LinAlgError(str(error)) from error
        X, y = factor.solve(C), factor.solve(rhs)
        core = cho_factor(self._W + C.T @ X, check_finite=False)
        return (y - X @ cho_solve(core, C.T @ y, check_finite=False)) / self._scale

    def _solve_W(self, rhs: np.ndarray) -> np.ndarray:
        return cho_solve(cho_factor(self._W, check_finite=False), rhs, check_finite=False)


class _Columns:
    """Columns of MᵀQM, kept once computed."""

    def __init__(self, equilibrium: Equilibrium, Q: sparse.csr_array, gas_measured: bool) -> None:
        self._equilibrium, self._Q, self._gas_measured = equilibrium, Q, gas_measured
        self._place = np.full(len(equilibrium.A), -1)
        self._data = np.empty((len(equilibrium.A), 0), order="F")
        self._count = 0

    def of(self, nodes: np.ndarray) -> np.ndarray:
        """Columns of the given nodes (m,), (n, m)."""
        missing = nodes[self._place[nodes] < 0]
        self._reserve(self._count + len(missing))
        for node in missing:
            self._data[:, self._count] = self._column(node)
            self._place[node] = self._count
            self._count += 1
        return self._data[:, self._place[nodes]]

    def _column(self, node: int) -> np.ndarray:
        M = self._equilibrium.response(np.array([node]), self._gas_measured)[:, 0]
        return self._equilibrium.adjoint(self._Q @ M, self._gas_measured)

    def _reserve(self, columns: int) -> None:
        """Make room by doubling: most frames add a few."""
        n, room = self._data.shape
        if columns > room:
            data = np.empty((n, max(columns, 2 * room)), order="F")
            data[:, : self._count] = self._data[:, : self._count]
            self._data = data


def farthest_points(points: np.ndarray, within: float) -> np.ndarray:
    """Indices of points (n, 3), each the farthest from those before, until all are near one."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    while len(chosen) < len(points):
        offset = points - points[chosen[-1]]
        np.minimum(distance, np.einsum("ij,ij->i", offset, offset), out=distance)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= within**2:
            break
        chosen.append(farthest)
    return np.array(chosen)
