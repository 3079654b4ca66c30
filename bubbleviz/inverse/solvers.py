"""What every solver of the inverse problem offers, and their names."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy import sparse
from scipy.linalg.lapack import dposv

from bubbleviz.errors import InputError
from bubbleviz.inverse.problem import Equilibrium, FrameProblem, Pressure, natural_residual

# Block principal pivoting for bound-constrained least squares.


_FULL_EXCHANGES = 3  # without progress before single ones; chosen


def times(H: np.ndarray, x: np.ndarray) -> np.ndarray:
    """H x of a symmetric matrix (c, c) and a vector (c,) most of which is 0."""
    used = np.flatnonzero(x)
    return x[used] @ H[used]  # rows of a symmetric matrix lie together in memory


def part(H: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Rows and columns `nodes` (k,) of a matrix (c, c): whole rows first, which is faster."""
    return H.take(nodes, axis=0).take(nodes, axis=1)


def nonnegative_qp(
    H: np.ndarray, f: np.ndarray, start: np.ndarray, tolerance: float = 1e-9, limit: int = 100
) -> tuple[np.ndarray, int, bool]:
    """Minimise ½ xᵀHx + fᵀx over x ≥ 0 by exchanging all violated indices at a time.

    Falls back to exchanging only the last violated index (Murty) when a few full exchanges do not
    reduce their number, which makes it finite for every positive definite H (Júdice and Pires
    1994; Kim and Park 2011).

    Parameters
    ----------
    H : (c, c) array
        Symmetric and positive definite.
    f : (c,) array
    start : (c,) bool array
        Guess of the indices with x > 0; the solution of the last frame costs one or two pivots.
    tolerance : float
        Violation of the multipliers that counts as zero, relative to the largest |f|.
    limit : int
        Pivots allowed.

    Returns
    -------
    x : (c,) array
    pivots : int
    converged : bool
    """
    positive = start.copy()
    slack = tolerance * float(np.max(np.abs(f), initial=0.0))
    fewest, exchanges = len(f) + 1, _FULL_EXCHANGES
    x = np.zeros_like(f)
    for pivot in range(1, limit + 1):
        inside = np.flatnonzero(positive)
        x = np.zeros_like(f)
        multiplier = f
        if inside.size:
            # LAPACK itself: SciPy's checks take longer than a small part
            _, solved, failed = dposv(part(H, inside).T, f[inside], overwrite_a=True)
            if failed:  # not positive definite to working precision
                return np.zeros_like(f), pivot, False
            x[inside] = -np.asarray(solved)
            multiplier = times(H, x) + f
        violated = np.where(positive, x < 0.0, multiplier < -slack)
        count = int(np.count_nonzero(violated))
        if count == 0:
            return x, pivot, True
        if count < fewest:
            fewest, exchanges = count, _FULL_EXCHANGES
        elif exchanges > 0:
            exchanges -= 1
        else:
            violated[: np.flatnonzero(violated)[-1]] = False
        positive ^= violated
    return np.maximum(x, 0.0), limit, False


# The Hessian MᵀQM + λL of Eq. 24: formed whole once, or on a fine mesh where it is asked for.


class ReducedHessian:
    """Model Hessian of the reference configuration, for the gas measured and estimated.

    Parameters
    ----------
    equilibrium : Equilibrium
    Q : (n, n) sparse array
    lambda_ : float
    """

    def __init__(self, equilibrium: Equilibrium, Q: sparse.csr_array, lambda_: float) -> None:
        self._equilibrium, self._Q, self._H1 = equilibrium, Q, (lambda_ * equilibrium.L).tocsr()
        if equilibrium.inverse is None:  # too many nodes
            return
        M = equilibrium.response(np.arange(len(equilibrium.A)), gas_measured=True)
        self._measured = M.T @ (Q @ M) + self._H1.toarray()
        # The gas law adds −b wᵀ to M: two rank-one terms (b: bulge under unit pressure).
        bulge_pull = Q @ equilibrium.bulge
        self._gas = equilibrium.gas_response(M)
        self._pull = M.T @ bulge_pull - 0.5 * (equilibrium.bulge @ bulge_pull) * self._gas

    @cached_property
    def _estimated(self) -> np.ndarray:
        """The Hessian where the gas pressure is estimated too, (n, n)."""
        mixed = np.outer(self._pull, self._gas)
        mixed += mixed.T
        return np.subtract(self._measured, mixed, out=mixed)

    def block(self, nodes: np.ndarray, gas_measured: bool, scale: float = 1.0) -> np.ndarray:
        """`scale` times the rows and columns of the given nodes (k,), (k, k)."""
        if self._equilibrium.inverse is None:
            M = self._equilibrium.response(nodes, gas_measured)
            H = M.T @ (self._Q @ M) + self._H1[nodes][:, nodes].toarray()
        else:
            H = part(self._measured if gas_measured else self._estimated, nodes)
        H *= scale
        return H


# Eq. 24: the problem in p_c alone, solved by an active set that starts from the last frame.
#
# Eliminating u leaves the Hessian MᵀQM + λL. It is that of the reference configuration with every
# pixel valid, formed once; what a frame changes (missing pixels, robust weights, rays re-cast at
# the current shape) enters through the exact gradient, and a few corrections take the rest out.


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


# Eq. 23 as the paper has it: one sparse QP in u, p_c and p_v, solved by OSQP from nothing.


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
