"""Eq. 23 as the paper has it: one sparse QP in u, p_c and p_v, solved by OSQP."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure

TOLERANCE = 1e-5  # of a problem whose numbers are of order one; chosen


class OsqpSolver:
    """Set up once, factorised once, then only values change from frame to frame.

    Parameters
    ----------
    equilibrium : Equilibrium
    tolerance : float, optional
        Absolute and relative tolerance of OSQP on the dimensionless problem.
    max_iterations : int
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        tolerance: float | None = None,
        max_iterations: int = 10_000,
    ) -> None:
        self._equilibrium = equilibrium
        self._settings = {
            "eps_abs": tolerance or TOLERANCE,
            "eps_rel": tolerance or TOLERANCE,
            "max_iter": max_iterations,
            "verbose": False,
            "polishing": False,
        }
        self._solver: Any = None
        self._scale = 1.0
        self._data = np.zeros(0)

    def __call__(self, problem: FrameProblem) -> Pressure:
        """Solution of one frame, started from that of the last."""
        if self._solver is None:
            self._set_up(problem)
        else:
            self._update(problem)
        result = self._solver.solve(raise_error=False)
        n = len(problem.g)
        pressure = np.maximum(result.x[n : 2 * n], 0.0)
        pressure[~problem.allowed] = 0.0
        return Pressure(pressure, result.info.iter, result.info.status_val == 1)

    def _set_up(self, problem: FrameProblem) -> None:
        import osqp  # only where it is the chosen solver

        eq, n = self._equilibrium, len(problem.g)
        self._scale = 1.0 / max(problem.Q.diagonal().mean(), 1e-12)
        areas = sparse.diags_array(eq.A)
        column = sparse.csc_array(eq.A[:, None])
        rows: Any = [
            [eq.L, areas, -column],
            [sparse.csc_array(eq.beta[None, :]), None, sparse.csc_array([[1.0]])],
            [None, sparse.eye_array(n), None],
            [None, None, sparse.csc_array([[1.0]])],
        ]
        self._solver = osqp.OSQP()
        P = self._hessian(problem)
        self._data = P.data
        lower, upper = self._bounds(problem)
        self._solver.setup(
            P, self._linear(problem), _for_osqp(sparse.block_array(rows)), lower, upper,
            **self._settings,
        )  # fmt: skip

    def _update(self, problem: FrameProblem) -> None:
        lower, upper = self._bounds(problem)
        data = self._hessian(problem).data
        values = {} if np.array_equal(data, self._data) else {"Px": data}
        self._data = data
        self._solver.update(q=self._linear(problem), l=lower, u=upper, **values)

    def _hessian(self, problem: FrameProblem) -> sparse.csc_matrix:
        H1 = problem.lambda_ * self._equilibrium.L
        blocks = sparse.block_diag((problem.Q, H1, sparse.csc_array((1, 1))))
        return _for_osqp(sparse.triu(blocks) * self._scale)

    def _linear(self, problem: FrameProblem) -> np.ndarray:
        return np.concatenate([-problem.g, problem.tau, [0.0]]) * self._scale

    def _bounds(self, problem: FrameProblem) -> tuple[np.ndarray, np.ndarray]:
        """Equilibrium, gas law, p_c ≥ 0, measured p_v; an infinite pair switches a row off."""
        n, gas = len(problem.g), problem.measured_gas
        law = (0.0, 0.0) if gas is None else (-np.inf, np.inf)
        known = (-np.inf, np.inf) if gas is None else (gas, gas)
        zero = np.zeros(n)
        highest = np.where(problem.allowed, np.inf, 0.0)
        lower = np.concatenate([zero, [law[0]], zero, [known[0]]])
        upper = np.concatenate([zero, [law[1]], highest, [known[1]]])
        return lower, upper


class ColdOsqp:
    """The same, set up afresh for every problem: the baseline to beat.

    Parameters
    ----------
    equilibrium : Equilibrium
    tolerance : float, optional
    """

    def __init__(self, equilibrium: Equilibrium, tolerance: float | None = None) -> None:
        self._equilibrium, self._tolerance = equilibrium, tolerance

    def __call__(self, problem: FrameProblem) -> Pressure:
        """Set up, factorise and solve one problem."""
        return OsqpSolver(self._equilibrium, self._tolerance)(problem)


def _for_osqp(matrix: sparse.sparray) -> sparse.csc_matrix:
    """OSQP takes nothing but a `csc_matrix` with 32-bit indices."""
    csc = sparse.csc_matrix(matrix)
    csc.sort_indices()
    csc.indices, csc.indptr = csc.indices.astype(np.int32), csc.indptr.astype(np.int32)
    return csc
