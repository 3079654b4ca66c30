"""Eq. 23 by an interior-point method: slow, and accurate enough to certify other solvers."""

from __future__ import annotations

from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from bubbleviz.inverse import Equilibrium, FrameProblem, Pressure

_ZERO = 1e-6  # of the largest pressure: an interior point is nowhere exactly zero


class InteriorPoint:
    """A solver to register in `SOLVERS`; every call starts cold."""

    def __init__(self, equilibrium: Equilibrium) -> None:
        self._equilibrium = equilibrium

    def select(self, problem: FrameProblem, start: np.ndarray) -> Pressure:
        return self._solved(problem)

    def refine(self, problem: FrameProblem, start: Pressure) -> Pressure:
        return self._solved(problem)

    def _solved(self, problem: FrameProblem) -> Pressure:
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
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
        result = clarabel.DefaultSolver(
            sparse.csc_matrix(sparse.triu(P)),
            q,
            sparse.csc_matrix(sparse.block_array(rows)),
            b,
            [clarabel.ZeroConeT(n + 1), clarabel.NonnegativeConeT(k)],
            settings,
        ).solve()
        pressure = np.zeros(n)
        pressure[allowed] = np.asarray(result.x)[n : n + k]
        pressure[pressure < _ZERO * pressure.max()] = 0.0
        return Pressure(pressure, result.iterations, result.status == clarabel.SolverStatus.Solved)
