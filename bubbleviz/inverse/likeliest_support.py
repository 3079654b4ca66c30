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
from scipy.linalg.blas import dger

from bubbleviz.inverse.solvers.pivoting import nonnegative_qp, part

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
        support, pivots, solved = self._pressed(start)
        posterior = _Swept(np.block([[self.hessian, self.linear[:, None]], [self.linear, 0.0]]))
        prior = _Swept(self.smoothness)
        for _ in range(len(start)):
            if not (solved and support.any()):
                break
            posterior.sweep(support)
            prior.sweep(support)
            if (posterior.matrix[:-1, -1][support] >= 0.0).any():  # −p: some do not press
                support, count, solved = self._pressed(support)
                pivots += count
                continue
            gain = self._gain(support, posterior.matrix, prior.matrix)
            best = int(np.argmax(gain))
            if gain[best] <= _GAIN:
                break
            support = support.copy()
            support[best] ^= True
            pivots += 1
        return support, pivots, solved

    def _pressed(self, support: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Nodes of a support (c,) bool under pressure, pivots, and whether it converged."""
        nodes = np.flatnonzero(support)
        H = part(self.hessian, nodes)
        p, pivots, solved = nonnegative_qp(H, self.linear[nodes], np.ones(len(nodes), bool))
        pressed = np.zeros_like(support)
        pressed[nodes[p > 0.0]] = True
        return (pressed if solved else support), pivots, solved

    def _gain(self, support: np.ndarray, posterior: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """By how much the evidence rises where a node (c,) is taken out of the support or in."""
        slope = posterior[:-1, -1]  # −p of the support, the gradient of the others
        precision, prior_precision = np.diag(posterior)[:-1], np.diag(prior)
        gain = 0.5 * np.log(prior_precision / precision) + 0.5 * slope**2 / precision
        gain[~support & (slope >= 0.0)] = -np.inf
        added_cuts = self.degree - 2.0 * self.neighbours[:, support].sum(axis=1)
        return gain + np.where(support, _CUT, -_CUT) * added_cuts


class _Swept:
    """A symmetric matrix solved for some of its unknowns, one more or less at a time.

    Swept by a set S (Goodnight 1979), M becomes −M_SS⁻¹ there, the Schur complement among the
    others, and M_SS⁻¹ M_S· between.

    Parameters
    ----------
    matrix : (c, c) array
    """

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = np.array(matrix, order="F")
        self._swept = np.zeros(len(matrix), bool)

    def sweep(self, unknowns: np.ndarray) -> None:
        """Have it swept by these (up to c,) bool, and by no others."""
        wanted = np.zeros_like(self._swept)
        wanted[: len(unknowns)] = unknowns
        if not self._swept.any():
            self._sweep_all(wanted)
        for k in np.flatnonzero(wanted ^ self._swept):
            column = self.matrix[:, k].copy()
            pivot = column[k]
            self.matrix = dger(-1.0 / pivot, column, column, a=self.matrix, overwrite_a=True)
            column /= pivot if wanted[k] else -pivot
            self.matrix[k] = self.matrix[:, k] = column
            self.matrix[k, k] = -1.0 / pivot
        self._swept = wanted

    def _sweep_all(self, wanted: np.ndarray) -> None:
        """The same at once, for a matrix not swept yet."""
        S, others = np.flatnonzero(wanted), np.flatnonzero(~wanted)
        between = self.matrix[np.ix_(S, others)]
        inverse = np.linalg.inv(part(self.matrix, S))
        solved = inverse @ between
        self.matrix[np.ix_(S, S)] = -inverse
        self.matrix[np.ix_(S, others)] = solved
        self.matrix[np.ix_(others, S)] = solved.T
        self.matrix[np.ix_(others, others)] -= between.T @ solved
        self._swept = wanted
