"""What counts as more than noise: the weight of the L1 term."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium

_SAMPLE = 200
"""Nodes, spread over the membrane, among which the best-seen one is looked for."""


def detection_threshold(equilibrium: Equilibrium, Q: sparse.csr_array) -> np.ndarray:
    """L1 weights τ (n,) of the linear membrane, see `universal_threshold`.

    Under noise the gradient at p_c = 0 is Mᵀ Dᵀ W ε with covariance MᵀQM.
    """
    n = len(equilibrium.A)
    sample = sampled(n)
    M = equilibrium.response(sample)
    sigma = np.sqrt(np.einsum("ij,ij->j", M, Q @ M)) / equilibrium.A[sample]
    return universal_threshold(sigma, n) * equilibrium.A


def sampled(n: int) -> np.ndarray:
    """Indices of nodes spread over n of them."""
    return np.arange(0, n, max(1, n // _SAMPLE))


def universal_threshold(sigma: np.ndarray, n: int) -> float:
    """Pull per area that noise alone exceeds at none of n nodes: √(2 ln n) σ.

    The factor is the universal threshold of Donoho and Johnstone (1994) for n values. The same
    penalty per newton holds everywhere, that of the best-seen node, so that unseen parts attract no
    pressure.

    Parameters
    ----------
    sigma : (s,) array
        Standard deviation of the pull of noise per area, at nodes spread over the membrane.
    n : int
    """
    return float(np.sqrt(2.0 * np.log(n)) * np.max(sigma))
