"""Eq. 24: the problem in p_c alone, solved by an active set that starts from the last frame.

Eliminating u leaves the Hessian MᵀQM + λL. It is that of the reference configuration with every
pixel valid, formed once; what a frame changes (missing pixels, robust weights, rays re-cast at the
current shape) enters through the exact gradient, and a few corrections take the rest out.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure, natural_residual
from bubbleviz.inverse.solvers.pivoting import nonnegative_qp, times
from bubbleviz.inverse.solvers.reduced_hessian import ReducedHessian

_KKT_TOLERANCE = 1e-3  # of a problem whose numbers are of order one, see `Scales`

_SUPPORT_CHANGE = 0.05
"""Relative change of p_c that no longer moves the support by more than its edge nodes."""

_FIRST_NODES, _FIRST_SHARE = 100, 0.05
"""Nodes with which a frame without contact before it starts; on a fine mesh a share of all."""

_BETTER_SEEN = 0.95
"""Quantile of the nodes by how well this frame sees them over the reference."""

_SELECTIONS = 8
"""Corrections that selecting a support is worth; the next frame goes on from there."""

_CORRECTIONS = 30
"""Most of the debiased solution; chosen."""


class ActiveSetSolver:
    """Warm-started active set with a model Hessian.

    Parameters
    ----------
    equilibrium : Equilibrium
    reference_Q : (n, n) sparse array
        Q of a frame with every pixel valid in the reference configuration.
    lambda_ : float
        Weight of the H1 term.
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        reference_Q: sparse.csr_array,
        lambda_: float,
    ) -> None:
        self._equilibrium = equilibrium
        self._diagonal = reference_Q.diagonal()
        self._hessian = ReducedHessian(equilibrium, reference_Q, lambda_)
        self._neighbours = abs(equilibrium.L).tocsr()
        self._scaled_for, self._scale = reference_Q, 1.0

    def select(self, problem: FrameProblem, start: np.ndarray) -> Pressure:
        """Solve with the L1 term, until the support stands.

        Parameters
        ----------
        problem : FrameProblem
        start : (n,) array
            The selection of the last frame.
        """
        pressure, pivots = start, 0
        for _ in range(_SELECTIONS):
            gradient = self._equilibrium.gradient(problem, pressure)
            work = np.flatnonzero(self._near(pressure > 0.0) | self._pulled(gradient, pressure))
            H = self._model(problem, work)
            before = pressure
            pressure, count = _correct(H, pressure, gradient, work)
            pivots += count
            change = (pressure - before)[work]
            if np.max(np.abs(change), initial=0.0) <= _SUPPORT_CHANGE * np.max(pressure):
                break
        gradient[work] += times(H, change)
        return Pressure(pressure, pivots, True, gradient - problem.tau)

    def refine(self, problem: FrameProblem, start: Pressure) -> Pressure:
        """Solve on a support without the L1 term, to the tolerance of the KKT conditions."""
        work = np.flatnonzero(problem.allowed)
        H = self._model(problem, work)
        pressure, gradient = start.values, start.gradient
        if gradient is None:
            gradient = self._equilibrium.gradient(problem, pressure, work)
        pivots = 0
        for _ in range(_CORRECTIONS):
            pressure, count = _correct(H, pressure, gradient, work)
            pivots += count
            gradient = self._equilibrium.gradient(problem, pressure, work)
            residual = natural_residual(self._equilibrium.A, problem, pressure, gradient)
            if residual <= _KKT_TOLERANCE:
                return Pressure(pressure, pivots, True, gradient)
        return Pressure(pressure, pivots, False, gradient)

    def _pulled(self, gradient: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """The nodes with the strongest pull, as many as are in contact: the others come later."""
        slope = gradient / self._equilibrium.A
        first = max(_FIRST_NODES, int(_FIRST_SHARE * len(slope)))
        most = max(first, int(np.count_nonzero(pressure)))
        bound = min(0.0, np.partition(slope, most)[most]) if most < len(slope) else 0.0
        return slope < bound

    def _model(self, problem: FrameProblem, work: np.ndarray) -> np.ndarray:
        """Model Hessian of the nodes `work`, scaled to the weight of this frame's pixels.

        To that of the better-seen nodes: a model too stiff is slow, one too soft overshoots.
        """
        if problem.Q is not self._scaled_for:
            diagonal = problem.Q.diagonal()
            seen = (self._diagonal > 0.0) & (diagonal > 0.0)
            ratio = diagonal[seen] / self._diagonal[seen]
            place = int(_BETTER_SEEN * len(ratio))
            self._scale = float(np.partition(ratio, place)[place]) if ratio.size else 1.0
            self._scaled_for = problem.Q
        return self._hessian.block(work, problem.measured_gas is not None, self._scale)

    def _near(self, mask: np.ndarray) -> np.ndarray:
        return mask | (self._neighbours @ mask.astype(float) > 0.0)


def _correct(
    H: np.ndarray, pressure: np.ndarray, gradient: np.ndarray, work: np.ndarray
) -> tuple[np.ndarray, int]:
    """Minimise over the nodes `work` with the gradient at `pressure` and the model Hessian H."""
    here, slope = pressure[work], gradient[work]
    # From nothing, start where the pull is strongest: a guess of all it reaches is far too large.
    start = here > 0.0 if here.any() else slope < 0.5 * np.min(slope, initial=0.0)
    x, pivots, _ = nonnegative_qp(H, slope - times(H, here), start)
    corrected = np.zeros_like(pressure)
    corrected[work] = x
    return corrected, pivots
