"""Eq. 23 by an interior-point method: slow, and accurate enough to certify the others."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure


class ClarabelSolver:
    """Interior-point reference solver.

    Parameters
    ----------
    equilibrium : Equilibrium
    tolerance : float, optional
        Relative and absolute gap and infeasibility; None for Clarabel's own.
    """

    def __init__(self, equilibrium: Equilibrium, tolerance: float | None = None) -> None:
        self._equilibrium, self._tolerance = equilibrium, tolerance

    def __call__(self, problem: FrameProblem) -> Pressure:
        """Solve one problem; every call starts cold."""
        import clarabel  # only where it is the chosen solver

        eq, n = self._equilibrium, len(problem.g)
        allowed = np.flatnonzero(problem.allowed)
        k = len(allowed)
        scale = 1.0 / max(float(problem.Q.diagonal().mean()), 1e-300)
        H1 = problem.lambda_ * eq.L[allowed][:, allowed]
        P = sparse.block_diag((problem.Q, H1, sparse.csc_array((1, 1)))) * scale
        q = np.concatenate([-problem.g, problem.tau[allowed], [0.0]]) * scale
        areas = sparse.csc_array((eq.A[allowed], (allowed, np.arange(k))), shape=(n, k))
        gas_row = np.zeros(n) if problem.measured_gas is not None else eq.beta
        rows: Any = [
            [eq.L, areas, -sparse.csc_array(eq.A[:, None])],
            [sparse.csc_array(gas_row[None, :]), None, sparse.csc_array([[1.0]])],
            [None, -sparse.eye_array(k), None],
        ]
        b = np.zeros(n + 1 + k)
        b[n] = problem.measured_gas or 0.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        if self._tolerance is not None:
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self._tolerance
        cones = [clarabel.ZeroConeT(n + 1), clarabel.NonnegativeConeT(k)]
        result = clarabel.DefaultSolver(
            sparse.csc_matrix(sparse.triu(P)),
            q,
            sparse.csc_matrix(sparse.block_array(rows)),
            b,
            cones,
            settings,
        ).solve()
        pressure = np.zeros(n)
        pressure[allowed] = np.maximum(np.asarray(result.x)[n : n + k], 0.0)
        solved = result.status == clarabel.SolverStatus.Solved
        return Pressure(pressure, result.iterations, solved)
