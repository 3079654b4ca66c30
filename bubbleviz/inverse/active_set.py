"""Eq. 24: the problem in p_c alone, solved by an active set that starts from the last frame.

Eliminating u leaves a dense Hessian MᵀQM + λL. It is formed once, for the reference configuration
with every pixel valid; what a frame changes (missing pixels, robust weights, rays re-cast at the
current shape) enters through the exact gradient, and a few corrections take the rest out.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.inverse.pivoting import nonnegative_qp
from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure, natural_residual

_SUPPORT_CHANGE = 0.05
"""Relative change of p_c that no longer moves the support by more than its edge nodes."""


class ActiveSetSolver:
    """Warm-started active set with a dense model Hessian.

    Parameters
    ----------
    equilibrium : Equilibrium
    reference_Q : (n, n) sparse array
        Q of a frame with every pixel valid in the reference configuration.
    tolerance : float
        Relative KKT residual of the debiased problem.
    corrections : int
        Most corrections in each of the two stages.
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        reference_Q: sparse.csr_array,
        tolerance: float = 1e-3,
        corrections: int = 30,
    ) -> None:
        self._equilibrium = equilibrium
        self._reference_Q = reference_Q
        self._weight = float(reference_Q.diagonal().sum())
        self._tolerance, self._corrections = tolerance, corrections
        self._hessians: dict[bool, np.ndarray] = {}
        self._neighbours = abs(equilibrium.L).tocsr()

    def select(self, problem: FrameProblem, start: np.ndarray) -> Pressure:
        """Solve with the L1 term, until the support stands.

        Parameters
        ----------
        problem : FrameProblem
        start : (n,) array
            The selection of the last frame.
        """
        pressure, pivots = start, 0
        for _ in range(self._corrections):
            gradient = self._equilibrium.gradient(problem, pressure)
            work = np.flatnonzero(self._near((pressure > 0.0) | (gradient < 0.0)))
            H = self._model(problem, work)
            before = pressure
            pressure, count = _correct(H, pressure, gradient, work)
            pivots += count
            change = (pressure - before)[work]
            if np.max(np.abs(change), initial=0.0) <= _SUPPORT_CHANGE * np.max(pressure):
                break
        gradient[work] += H @ change
        return Pressure(pressure, pivots, True, gradient - problem.tau)

    def refine(self, problem: FrameProblem, start: Pressure) -> Pressure:
        """Solve on a support without the L1 term, to the tolerance of the KKT conditions."""
        work = np.flatnonzero(problem.allowed)
        H = self._model(problem, work)
        pressure, gradient = start.values, start.gradient
        if gradient is None:
            gradient = self._equilibrium.gradient(problem, pressure)
        pivots = 0
        for _ in range(self._corrections):
            pressure, count = _correct(H, pressure, gradient, work)
            pivots += count
            gradient = self._equilibrium.gradient(problem, pressure)
            residual = natural_residual(self._equilibrium.A, problem, pressure, gradient)
            if residual <= self._tolerance:
                return Pressure(pressure, pivots, True, gradient)
        return Pressure(pressure, pivots, False, gradient)

    def _model(self, problem: FrameProblem, work: np.ndarray) -> np.ndarray:
        """Model Hessian of the nodes `work`, scaled to the weight of this frame's pixels."""
        return problem.weight / self._weight * self._hessian(problem)[np.ix_(work, work)]

    def _near(self, mask: np.ndarray) -> np.ndarray:
        return mask | (self._neighbours @ mask.astype(float) > 0.0)

    def _hessian(self, problem: FrameProblem) -> np.ndarray:
        """Model Hessian (n, n) for the gas estimated or measured."""
        gas_measured = problem.measured_gas is not None
        if gas_measured not in self._hessians:
            M = self._equilibrium.compliance(gas_measured)
            hessian = M.T @ (self._reference_Q @ M)
            hessian += (problem.lambda_ * self._equilibrium.L).toarray()
            self._hessians[gas_measured] = hessian
        return self._hessians[gas_measured]


def _correct(
    H: np.ndarray, pressure: np.ndarray, gradient: np.ndarray, work: np.ndarray
) -> tuple[np.ndarray, int]:
    """Minimise over the nodes `work` with the gradient at `pressure` and the model Hessian H."""
    here = pressure[work]
    x, pivots, _ = nonnegative_qp(H, gradient[work] - H @ here, here > 0.0)
    corrected = np.zeros_like(pressure)
    corrected[work] = x
    return corrected, pivots
