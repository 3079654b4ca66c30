"""Selection with the L1 term, then debiasing on the support, with any solver of Eq. 23."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.inverse.problem import (
    Equilibrium,
    FrameProblem,
    QPResult,
    Solution,
    natural_residual,
)

QPSolve = Callable[[FrameProblem], QPResult]
"""Solves one problem; may start from its own last solution."""


class TwoStage:
    """Runs two instances of a QP solver, so that each warm-starts from its own last frame.

    Parameters
    ----------
    equilibrium : Equilibrium
    make : callable
        Makes an instance of the solver.
    """

    def __init__(self, equilibrium: Equilibrium, make: Callable[[Equilibrium], QPSolve]) -> None:
        self._equilibrium = equilibrium
        self._selecting, self._debiasing = make(equilibrium), make(equilibrium)

    def solve(self, problem: FrameProblem, start: np.ndarray) -> Solution:
        """Solution of one frame; `start` is not used, the QP solvers keep their own."""
        eq = self._equilibrium
        first = self._selecting(problem)
        free = problem.debiased(self._support(problem, first.pressure))
        second = self._debiasing(free)
        displacement, gas = eq.displacement(second.pressure, problem.measured_gas)
        gradient = eq.gradient(free, second.pressure)
        return Solution(
            displacement,
            second.pressure,
            gas,
            np.where(free.allowed, first.pressure, 0.0),
            first.iterations + second.iterations,
            first.converged and second.converged,
            natural_residual(eq.A, free, second.pressure, gradient),
        )

    def _support(self, problem: FrameProblem, pressure: np.ndarray) -> np.ndarray:
        """Nodes nearer to carrying pressure than to having a multiplier.

        An interior-point or first-order iterate is nowhere exactly zero.
        """
        gradient = self._equilibrium.gradient(problem, pressure) / self._equilibrium.A
        top, scale = np.max(pressure, initial=0.0), problem.gradient_scale(self._equilibrium.A)
        return pressure * scale > np.maximum(gradient, 0.0) * top
