"""Which nodes touch: the support that explains a frame best, whatever support it was started from.

The pressure p on a support S has the prior N(0, (λ L_SS)⁻¹), so that the evidence of S (MacKay
1992) is, but for a constant,

    −min ½ pᵀHp + fᵀp + ½ ln det λL_SS − ½ ln det H_SS − β |∂S|,

with H and f those of the debiased problem and |∂S| the mesh edges between S and the rest: of all
supports those with a short boundary are the likely ones. Nodes are exchanged one at a time, the one
that gains most first, until none gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from bubbleviz.inverse.solvers.pivoting import DenseQuadratic, nonnegative_qp, part

_CUT = 0.5 * log(2.0)
"""β: a boundary has some two ways to go on at every node, and two mesh edges cut beside it."""
_GAIN = 1e-6
"""Least gain of an exchange, so that rounding does not repeat one for ever."""


@dataclass(frozen=True)
class SupportProblem:
    """Evidence of the supports within a set of nodes.

    Attributes
    ----------
    hessian, smoothness : (c, c) array
        H and λ L, both positive definite.
    linear : (c,) array
        f.
    neighbours : (c, c) bool array
        Nodes that share an edge.
    degree : (c,) array
        Neighbours of each node in the whole mesh.
    """

    hessian: np.ndarray
    smoothness: np.ndarray
    linear: np.ndarray
    neighbours: np.ndarray
    degree: np.ndarray

    def likeliest(self, start: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Support (c,) bool that no exchange of a node betters, pivots, and whether it converged.

        Parameters
        ----------
        start : (c,) bool array
        """
        support, pivots = start.copy(), 0
        for _ in range(len(start)):
            nodes = np.flatnonzero(support)
            H = DenseQuadratic(part(self.hessian, nodes))
            p, count, solved = nonnegative_qp(H, self.linear[nodes], np.ones(len(nodes), bool))
            pivots += count
            if not solved:
                return support, pivots, False
            support[nodes[p <= 0.0]] = False
            nodes, p = nodes[p > 0.0], p[p > 0.0]
            if not len(nodes):
                break
            gain = self._gain(support, nodes, p)
            best = int(np.argmax(gain))
            if gain[best] <= _GAIN:
                break
            support[best] ^= True
        return support, pivots, True

    def _gain(self, support: np.ndarray, nodes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """By how much the evidence rises where a node (c,) is taken out of the support or in."""
        others = np.flatnonzero(~support)
        gradient = self.linear[others] + (self.hessian[:, nodes] @ p)[others]
        variance, precision = _conditional(self.hessian, nodes, others)
        prior_variance, prior_precision = _conditional(self.smoothness, nodes, others)
        gain = np.empty(len(support))
        gain[nodes] = 0.5 * np.log(prior_variance / variance) - 0.5 * p**2 / variance
        found = 0.5 * gradient**2 / precision + 0.5 * np.log(prior_precision / precision)
        gain[others] = np.where(gradient < 0.0, found, -np.inf)
        added_cuts = self.degree - 2.0 * self.neighbours[:, nodes].sum(axis=1)
        return gain + np.where(support, _CUT, -_CUT) * added_cuts


def _conditional(
    precision: np.ndarray, nodes: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Variances of `nodes`, and the precision of each of `others` once those are given."""
    covariance = np.linalg.inv(part(precision, nodes))
    between = precision.take(others, axis=0).take(nodes, axis=1)
    explained = np.einsum("ij,ij->i", between @ covariance, between)
    return np.diag(covariance), precision[others, others] - explained
