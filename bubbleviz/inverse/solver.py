"""What every solver of the inverse problem offers, and their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy import sparse

from bubbleviz.errors import InputError
from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Solution
from bubbleviz.inverse.two_stage import TwoStage

DENSE_LIMIT = 5_000
"""Nodes up to which a dense Hessian is worth its memory (n² numbers)."""


class InverseSolver(Protocol):
    """Solves the problem of one frame after another."""

    def solve(self, problem: FrameProblem, start: np.ndarray) -> Solution:
        """Solution of one frame, started from a contact pressure (n,)."""


def _active_set(equilibrium: Equilibrium, reference_Q: sparse.csr_array) -> InverseSolver:
    from bubbleviz.inverse.active_set import ActiveSetSolver

    return ActiveSetSolver(equilibrium, reference_Q)


def _osqp(equilibrium: Equilibrium, reference_Q: sparse.csr_array) -> InverseSolver:
    from bubbleviz.inverse.osqp_solver import OsqpSolver

    return TwoStage(equilibrium, OsqpSolver)


def _osqp_cold(equilibrium: Equilibrium, reference_Q: sparse.csr_array) -> InverseSolver:
    from bubbleviz.inverse.osqp_solver import ColdOsqp

    return TwoStage(equilibrium, ColdOsqp)


def _clarabel(equilibrium: Equilibrium, reference_Q: sparse.csr_array) -> InverseSolver:
    from bubbleviz.inverse.clarabel_solver import ClarabelSolver

    return TwoStage(equilibrium, ClarabelSolver)


SOLVERS: dict[str, Callable[[Equilibrium, sparse.csr_array], InverseSolver]] = {
    "active-set": _active_set,
    "osqp": _osqp,
    "osqp-cold": _osqp_cold,
    "clarabel": _clarabel,
}


def make_solver(
    name: str | None, equilibrium: Equilibrium, reference_Q: sparse.csr_array
) -> InverseSolver:
    """Solver of the given name; by default the fastest that suits the mesh.

    Raises
    ------
    InputError
        No solver has that name.
    """
    if name is None:
        name = "active-set" if len(equilibrium.A) <= DENSE_LIMIT else "osqp"
    if name not in SOLVERS:
        raise InputError(f"{name}: no such solver; choose one of {', '.join(SOLVERS)}")
    return SOLVERS[name](equilibrium, reference_Q)
