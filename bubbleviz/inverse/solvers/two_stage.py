"""Selection with the L1 term, then debiasing on the support, with any solver of Eq. 23."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure

QPSolve = Callable[[FrameProblem], Pressure]
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

    def select(self, problem: FrameProblem, start: np.ndarray) -> Pressure:
        """Solve with the L1 term; `start` is not used, the QP solvers keep their own."""
        found = self._selecting(problem)
        support = self._support(problem, found.values)
        return Pressure(np.where(support, found.values, 0.0), found.iterations, found.converged)

    def refine(self, problem: FrameProblem, start: Pressure) -> Pressure:
        """Solve on a support without the L1 term."""
        return self._debiasing(problem)

    def _support(self, problem: FrameProblem, pressure: np.ndarray) -> np.ndarray:
        """Nodes nearer to carrying pressure than to having a multiplier.

        An interior-point or first-order iterate is nowhere exactly zero.
        """
        gradient = self._equilibrium.gradient(problem, pressure) / self._equilibrium.A
        top, scale = np.max(pressure, initial=0.0), problem.gradient_scale(self._equilibrium.A)
        return pressure * scale > np.maximum(gradient, 0.0) * top
