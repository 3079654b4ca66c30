"""Coulomb's bound on the tangential traction, as a cone programme."""

from __future__ import annotations

import numpy as np
from scipy import sparse

_NOTHING = 1e-4
"""Share of the largest p below which an interior point has come to 0, as it never does."""


def within_cone(
    H: np.ndarray, linear: np.ndarray, nodes: int, friction: float
) -> tuple[np.ndarray, bool]:
    """Minimise ½ xᵀHx − bᵀx with |q| ≤ μ p at every node; and whether that was solved.

    Parameters
    ----------
    H : (c, c) array
    linear : (c,) array
        b.
    nodes : int
        s: x is p (s,), q (2s,) and what is not bounded.
    friction : float
        μ.
    """
    import clarabel  # only where friction is bounded

    scale = 1.0 / float(H.diagonal().mean())
    size = len(linear)
    rows = np.arange(3 * nodes)
    columns = np.column_stack(
        [np.arange(nodes), nodes + 2 * np.arange(nodes), nodes + 2 * np.arange(nodes) + 1]
    ).ravel()
    values = -np.tile([friction, 1.0, 1.0], nodes)
    cone = sparse.csc_matrix((values, (rows, columns)), shape=(3 * nodes, size))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    result = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(H) * scale),
        -linear * scale,
        cone,
        np.zeros(3 * nodes),
        [clarabel.SecondOrderConeT(3)] * nodes,
        settings,
    ).solve()
    x = np.asarray(result.x)
    free = x[:nodes] <= _NOTHING * x[:nodes].max()
    x[: 3 * nodes][np.concatenate([free, np.repeat(free, 2)])] = 0.0
    return x, result.status == clarabel.SolverStatus.Solved
