"""What counts as more than noise: the weight of the L1 term."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium

THRESHOLD_SAMPLE = 200
"""Nodes, spread over the membrane, among which the best-seen one is looked for."""


def detection_threshold(equilibrium: Equilibrium, Q: sparse.csr_array) -> np.ndarray:
    """L1 weights τ (n,) that noise alone exceeds at no node: √(2 ln n) of its own σ.

    Under noise the gradient at p_c = 0 is Mᵀ Dᵀ W ε with covariance MᵀQM; the factor is the
    universal threshold of Donoho and Johnstone (1994) for n values. The same penalty per newton
    holds everywhere, that of the best-seen node, so that unseen parts attract no pressure.
    """
    n = len(equilibrium.A)
    sample = np.arange(0, n, max(1, n // THRESHOLD_SAMPLE))
    unit = np.zeros((n, len(sample)))
    unit[sample, np.arange(len(sample))] = 1.0
    M = equilibrium.response(unit)
    sigma = np.sqrt(np.einsum("ij,ij->j", M, Q @ M)) / equilibrium.A[sample]
    return np.sqrt(2.0 * np.log(n)) * np.max(sigma) * equilibrium.A
