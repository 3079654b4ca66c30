"""What every solver of the inverse problem offers, and their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy import sparse

from bubbleviz.errors import InputError
from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure
from bubbleviz.inverse.solvers.active_set import ActiveSetSolver
from bubbleviz.inverse.solvers.paper_solver import PaperSolver

RUBBER = "rubber"
"""The exact membrane, which `RubberEstimator` solves; the others are solvers of the linear one."""
LINEAR = "linear"
"""Best point on the curve of error against run time at every size of mesh, see `study accuracy`."""
PAPER = "paper"
"""Eq. 23 by OSQP, as in the paper."""


class InverseSolver(Protocol):
    """Solves the problem of one frame after another."""

    def select(self, problem: FrameProblem, start: np.ndarray) -> Pressure:
        """Solve with the L1 term, from a contact pressure (n,); exactly 0 off the support."""

    def refine(self, problem: FrameProblem, start: Pressure) -> Pressure:
        """Solve on the problem's support without the L1 term, from a selection."""


Make = Callable[[Equilibrium, sparse.csr_array, float], InverseSolver]
"""Makes a solver: equilibrium, Q of every pixel valid, λ."""

SOLVERS: dict[str, Make] = {
    LINEAR: ActiveSetSolver,
    PAPER: lambda equilibrium, Q, lambda_: PaperSolver(equilibrium),
}
BASE_MESH = {f"{name}-base": name for name in (RUBBER, LINEAR)}
"""Names for the sensor's own mesh alone: no finer one at the contact."""
ESTIMATORS = (RUBBER, *SOLVERS, *BASE_MESH)
"""Names for `EstimatorOptions.named` that take the sensor's mesh, or another size of it."""
SOLVER_NAMES = (*ESTIMATORS, "fast")
"""Names for `EstimatorOptions.named`; `fast` is the linear model on a coarse mesh."""
DROPPED = {
    "osqp": "since 0.3 it is called paper, and starts every frame from nothing; use paper",
    "osqp-cold": "since 0.3 it is called paper; use that",
    "clarabel": "it is gone since 0.3; use linear, which solves the same problem",
}
"""What became of solvers of version 0.2."""


def make_solver(
    name: str, equilibrium: Equilibrium, reference_Q: sparse.csr_array, lambda_: float
) -> InverseSolver:
    """Solver of the given name.

    Raises
    ------
    InputError
        No solver has that name.
    """
    if name not in SOLVERS:
        raise InputError(f"{name}: no such solver; choose one of {', '.join(SOLVER_NAMES)}")
    return SOLVERS[name](equilibrium, reference_Q, lambda_)
