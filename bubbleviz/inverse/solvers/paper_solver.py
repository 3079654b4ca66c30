"""Eq. 23 as the paper has it: one sparse QP in u, p_c and p_v, solved by OSQP from nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure

_TOLERANCE = 1e-5  # absolute and relative, of a problem whose numbers are of order one; chosen
_MOST_ITERATIONS = 10_000


class PaperSolver:
    """Sets up, factorises and solves every problem anew: the baseline to compare with.

    Parameters
    ----------
    equilibrium : Equilibrium
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        self._equilibrium = equilibrium

    def select(self, problem: FrameProblem, start: np.ndarray) -> Pressure:
        """Solve with the L1 term; a first-order iterate is nowhere exactly zero.

        Kept are the nodes that are nearer to carrying pressure than to having a multiplier.
        """
        found, areas = self._solved(problem), self._equilibrium.A
        gradient = self._equilibrium.gradient(problem, found.values) / areas
        share = found.values * problem.gradient_scale(areas)
        support = share > np.maximum(gradient, 0.0) * np.max(found.values, initial=0.0)
        return Pressure(np.where(support, found.values, 0.0), found.iterations, found.converged)

    def refine(self, problem: FrameProblem, start: Pressure) -> Pressure:
        """Solve on a support without the L1 term."""
        return self._solved(problem)

    def _solved(self, problem: FrameProblem) -> Pressure:
        import osqp  # only where it is the chosen solver

        eq, n = self._equilibrium, len(problem.g)
        scale = 1.0 / max(problem.Q.diagonal().mean(), 1e-12)
        H1 = problem.lambda_ * eq.L
        hessian = sparse.block_diag((problem.Q, H1, sparse.csc_array((1, 1))))
        linear = np.concatenate([-problem.g, problem.tau, [0.0]]) * scale
        rows: Any = [
            [eq.L, sparse.diags_array(eq.A), -sparse.csc_array(eq.A[:, None])],
            [sparse.csc_array(eq.beta[None, :]), None, sparse.csc_array([[1.0]])],
            [None, sparse.eye_array(n), None],
            [None, None, sparse.csc_array([[1.0]])],
        ]
        solver: Any = osqp.OSQP()
        solver.setup(
            _for_osqp(sparse.triu(hessian) * scale),
            linear,
            _for_osqp(sparse.block_array(rows)),
            *_bounds(problem),
            eps_abs=_TOLERANCE,
            eps_rel=_TOLERANCE,
            max_iter=_MOST_ITERATIONS,
            verbose=False,
            polishing=False,
        )
        result = solver.solve(raise_error=False)
        pressure = np.maximum(result.x[n : 2 * n], 0.0)
        pressure[~problem.allowed] = 0.0
        return Pressure(pressure, result.info.iter, result.info.status_val == 1)


def _bounds(problem: FrameProblem) -> tuple[np.ndarray, np.ndarray]:
    """Equilibrium, gas law, p_c ≥ 0, measured p_v; an infinite pair switches a row off."""
    n, gas = len(problem.g), problem.measured_gas
    law = (0.0, 0.0) if gas is None else (-np.inf, np.inf)
    known = (-np.inf, np.inf) if gas is None else (gas, gas)
    zero = np.zeros(n)
    highest = np.where(problem.allowed, np.inf, 0.0)
    lower = np.concatenate([zero, [law[0]], zero, [known[0]]])
    upper = np.concatenate([zero, [law[1]], highest, [known[1]]])
    return lower, upper


def _for_osqp(matrix: sparse.sparray) -> sparse.csc_matrix:
    """OSQP takes nothing but a `csc_matrix` with 32-bit indices."""
    csc = sparse.csc_matrix(matrix)
    csc.sort_indices()
    csc.indices, csc.indptr = csc.indices.astype(np.int32), csc.indptr.astype(np.int32)
    return csc
