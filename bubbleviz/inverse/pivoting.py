"""Block principal pivoting for bound-constrained least squares."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

_FULL_EXCHANGES = 3  # allowed without progress before single exchanges; chosen


def times(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    """H x of a symmetric matrix (c, c) and a vector (c,) most of which is 0."""
    used = np.flatnonzero(x)
    return x[used] @ H[used]  # rows of a symmetric matrix lie together in memory


def part(H: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Rows and columns `nodes` (k,) of a matrix (c, c); whole rows first is faster."""
    return H.take(nodes, axis=0).take(nodes, axis=1)


def nonnegative_qp(
    H: np.ndarray, f: np.ndarray, start: np.ndarray, tolerance: float = 1e-9, limit: int = 100
) -> tuple[np.ndarray, int, bool]:
    """Minimise ½ xᵀHx + fᵀx over x ≥ 0 by exchanging all violated indices at a time.

    Falls back to exchanging only the last violated index (Murty) when a few full exchanges do not
    reduce their number, which makes it finite for every positive definite H (Júdice and Pires
    1994; Kim and Park 2011).

    Parameters
    ----------
    H : (c, c) array
        Symmetric and positive definite.
    f : (c,) array
    start : (c,) bool array
        Initial active set: indices with x > 0. That of the last frame needs one or two pivots.
    tolerance : float
        Violation of the multipliers that counts as zero, relative to the largest |f|.
    limit : int
        Pivots allowed.

    Returns
    -------
    x : (c,) array
    pivots : int
    converged : bool
    """
    positive = start.copy()
    slack = tolerance * float(np.max(np.abs(f), initial=0.0))
    fewest, exchanges = len(f) + 1, _FULL_EXCHANGES
    x = np.zeros_like(f)
    for pivot in range(1, limit + 1):
        inside = np.flatnonzero(positive)
        x = np.zeros_like(f)
        multiplier = f
        if inside.size:
            # LAPACK itself: SciPy's checks take longer than a small part
            _, solved, failed = dposv(part(H, inside).T, f[inside], overwrite_a=True)
            if failed:  # not positive definite to working precision
                return np.zeros_like(f), pivot, False
            x[inside] = -np.asarray(solved)
            multiplier = times(H, x) + f
        violated = np.where(positive, x < 0.0, multiplier < -slack)
        count = int(np.count_nonzero(violated))
        if count == 0:
            return x, pivot, True
        if count < fewest:
            fewest, exchanges = count, _FULL_EXCHANGES
        elif exchanges > 0:
            exchanges -= 1
        else:
            violated[: np.flatnonzero(violated)[-1]] = False
        positive ^= violated
    return np.maximum(x, 0.0), limit, False
