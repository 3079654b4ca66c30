"""Contact pressure that explains the measurements of a frame, linearised at a shape.

    min  ½ ‖e − D (δ − S Δp) − R c‖²_W + ½ λ pᵀ L p + ½ cᵀ Σ⁻¹ c + τᵀ p   over p = p₀ + Δp ≥ 0

e is the residual of the shape, in ranges and, with colour, in optical flow, D their derivative by
the node positions, and δ the motion to equilibrium under the present pressure p₀. The nuisance
amplitudes c (errors of a measured gas pressure, of the whole image and beside missing returns,
friction of each contact) change the measurements by R c; they have a prior and are eliminated from
the misfit. The problem is solved with the L1 term first, to find where there is contact, then
without it on the support of maximal evidence, which removes its bias.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, sqrt

import numpy as np
from scipy import sparse
from scipy.linalg import solve
from scipy.linalg.blas import dger
from scipy.special import expit

from bubbleviz.inverse.measurements import Measurements
from bubbleviz.inverse.pivoting import nonnegative_qp, part
from bubbleviz.inverse.resolution import MESH_BLUR, universal_threshold
from bubbleviz.inverse.response import Tangent
from bubbleviz.membrane import (
    MembraneMesh,
    adjacency,
    connected_parts,
    cotangent_laplacian,
    dense_part,
    grown,
)

# Which nodes touch: the support of maximal evidence, independent of the initial one.
#
# The pressure p on a support S has the prior N(0, (λ L_SS)⁻¹), so that the evidence of S (MacKay
# 1992) is, but for a constant,
#
#     −min ½ pᵀHp + fᵀp + ½ ln det λL_SS − ½ ln det H_SS − β |∂S|,
#
# with H and f of the debiased problem and |∂S| the number of mesh edges between S and the other
# nodes: supports with a short boundary are more likely. Nodes are exchanged one at a time, the one
# with the largest gain first, until no exchange gains.


_BOUNDARY_COST = 0.5 * log(2.0)
"""β: a boundary has about two ways to continue at every node, and cuts two mesh edges there."""
MAX_EXCHANGE_NODES = 300
"""Most nodes of a contact whose support is optimised by its evidence: an exchange of one node costs
the square of their number, and the edge of a larger contact is a small part of it. Chosen."""
_MIN_GAIN = 1e-6
"""Least gain of an exchange: rounding errors must not repeat an exchange forever."""


@dataclass(frozen=True)
class SupportProblem:
    """Evidence of the supports within a set of nodes.

    Attributes
    ----------
    hessian, smoothness : (c, c) array
        H and λ L, both positive definite.
    linear : (c,) array
        f.
    neighbours : (c, c) bool array
        Nodes that share an edge.
    degree : (c,) array
        Neighbours of each node in the whole mesh.
    """

    hessian: np.ndarray
    smoothness: np.ndarray
    linear: np.ndarray
    neighbours: np.ndarray
    degree: np.ndarray

    def max_evidence(self, start: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Support (c,) bool that no exchange of a node improves, pivots, and whether it converged.

        Parameters
        ----------
        start : (c,) bool array
        """
        support, pivots, solved = self._nonnegative(start)
        posterior, prior = self._operators()
        for _ in range(len(start)):
            if not (solved and support.any()):
                break
            posterior.sweep(support)
            prior.sweep(support)
            if (
                posterior.matrix[:-1, -1][support] >= 0.0
            ).any():  # −p: some pressures are not positive
                support, count, solved = self._nonnegative(support)
                pivots += count
                continue
            gain = self._gain(support, posterior.matrix, prior.matrix)
            best = int(np.argmax(gain))
            if gain[best] <= _MIN_GAIN:
                break
            support = support.copy()
            support[best] ^= True
            pivots += 1
        return support, pivots, solved

    def averaged_pressure(self, support: np.ndarray) -> np.ndarray:
        """Mean pressure (c,), Pa, over a support and those that differ from it by one node.

        To first order, with independent exchanges: each has the probability e^gain / (1 + e^gain).
        """
        posterior, prior = self._operators()
        posterior.sweep(support)
        prior.sweep(support)
        inverse, slope = posterior.matrix[:-1, :-1], posterior.matrix[:-1, -1]
        probability = expit(self._gain(support, posterior.matrix, prior.matrix))
        exchanged = probability * slope / np.diag(inverse)
        mean = np.where(support, inverse @ exchanged - slope, -exchanged)
        return np.maximum(mean, 0.0)

    def _operators(self) -> tuple[_SweepOperator, _SweepOperator]:
        """Matrices of the posterior, with its linear term, and of the prior."""
        posterior = np.block([[self.hessian, self.linear[:, None]], [self.linear, 0.0]])
        return _SweepOperator(posterior), _SweepOperator(self.smoothness)

    def _nonnegative(self, support: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Nodes (c,) bool of a support that are under pressure, pivots, and if it converged."""
        nodes = np.flatnonzero(support)
        H = part(self.hessian, nodes)
        p, pivots, solved = nonnegative_qp(H, self.linear[nodes], np.ones(len(nodes), bool))
        positive = np.zeros_like(support)
        positive[nodes[p > 0.0]] = True
        return (positive if solved else support), pivots, solved

    def _gain(self, support: np.ndarray, posterior: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """Gain of evidence by removing each node (c,) from the support or adding it."""
        slope = posterior[:-1, -1]  # −p on the support, the gradient elsewhere
        precision, prior_precision = np.diag(posterior)[:-1], np.diag(prior)
        # Both are negative on the support; their signs differ by rounding only.
        valid = (prior_precision > 0.0) == (precision > 0.0)
        shrink = np.where(valid, prior_precision / precision, 1.0)
        gain = 0.5 * np.log(shrink) + 0.5 * slope**2 / precision
        gain[~valid | (~support & (slope >= 0.0))] = -np.inf
        added_cuts = self.degree - 2.0 * self.neighbours[:, support].sum(axis=1)
        return gain + np.where(support, _BOUNDARY_COST, -_BOUNDARY_COST) * added_cuts


class _SweepOperator:
    """Sweep operator: a symmetric matrix inverted for some of its unknowns, updated one by one.

    Swept by a set S (Goodnight 1979), M becomes −M_SS⁻¹ on S, the Schur complement on the other
    unknowns, and M_SS⁻¹ M_S· between the two.

    Parameters
    ----------
    matrix : (c, c) array
    """

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = np.array(matrix, order="F")
        self._swept = np.zeros(len(matrix), bool)

    def sweep(self, unknowns: np.ndarray) -> None:
        """Sweep by exactly these unknowns, (up to c,) bool."""
        wanted = np.zeros_like(self._swept)
        wanted[: len(unknowns)] = unknowns
        if not self._swept.any():
            self._sweep_all(wanted)
        for k in np.flatnonzero(wanted ^ self._swept):
            column = self.matrix[:, k].copy()
            pivot = column[k]
            self.matrix = dger(-1.0 / pivot, column, column, a=self.matrix, overwrite_a=True)
            column /= pivot if wanted[k] else -pivot
            self.matrix[k] = self.matrix[:, k] = column
            self.matrix[k, k] = -1.0 / pivot
        self._swept = wanted

    def _sweep_all(self, wanted: np.ndarray) -> None:
        """Sweep an unswept matrix by all of them at once."""
        S, others = np.flatnonzero(wanted), np.flatnonzero(~wanted)
        between = self.matrix[np.ix_(S, others)]
        inverse = np.linalg.inv(part(self.matrix, S))
        solved = inverse @ between
        self.matrix[np.ix_(S, S)] = -inverse
        self.matrix[np.ix_(S, others)] = solved
        self.matrix[np.ix_(others, S)] = solved.T
        self.matrix[np.ix_(others, others)] -= between.T @ solved
        self._swept = wanted


_COLD_SHARE = 0.05
"""Share of the membrane's area in the first working set without a warm start. A fixed number of
nodes would cover only a small part of a contact on a mesh that is fine there."""
_GRADIENT_TOLERANCE = 1e-6
"""Negative gradient that counts as zero, relative to the largest."""


TouchRule = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps a support (n,) bool and the pressure on it to the part of it that may be contact."""


@dataclass(frozen=True)
class Prior:
    """Prior of the contact pressure.

    Attributes
    ----------
    smoothness : (n, n) sparse array
        λ L of the H1 term, 1/Pa².
    threshold : (n,) array
        τ of the L1 term, 1/Pa: the same for each area.
    rings : (d, n) int array
        Each node and its neighbours, as of `MembraneMesh`.
    """

    smoothness: sparse.csr_array
    threshold: np.ndarray
    rings: np.ndarray

    def with_neighbours(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes (n,) bool and their neighbours."""
        return grown(self.rings, nodes)


def smoothness(mesh: MembraneMesh, weight: float) -> sparse.csr_array:
    """λ L of a mesh, with no pressure on its rim, (n, n), for λ in 1/Pa²."""
    held = sparse.diags_array(np.where(mesh.rim, 0.0, 1.0))
    return (weight * (held @ cotangent_laplacian(mesh) @ held)).tocsr()


@dataclass(frozen=True)
class Selection:
    """Support of the contact, found by the problem with the L1 term.

    Attributes
    ----------
    support : (n,) bool array
    pivots : int
        Of the solver.
    converged : bool
    complete : bool
        No node outside it has a negative gradient.
    """

    support: np.ndarray
    pivots: int = 0
    converged: bool = True
    complete: bool = True


@dataclass(frozen=True)
class ContactPressure:
    """Solution of a `ContactProblem`.

    Attributes
    ----------
    support : (n,) bool array
        Nodes that may touch.
    pressure : (n,) array
        Pa.
    motion : (n, 3) array
        To first order, m.
    pivots : int
    converged, complete : bool
        As of `Selection`.
    amplitudes : (a,) array
        Of the nuisances.
    problem : ContactProblem
        The problem solved.
    """

    support: np.ndarray
    pressure: np.ndarray
    motion: np.ndarray
    pivots: int
    converged: bool
    complete: bool
    amplitudes: np.ndarray
    problem: ContactProblem

    @cached_property
    def nodes(self) -> np.ndarray:
        """Nodes under pressure, (s,)."""
        return np.flatnonzero(self.pressure)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the pressures of `nodes`, Pa, and the amplitudes, (s + a, s + a)."""
        return self.problem.covariance(self.nodes)


class ContactProblem:
    """The problem of one frame, linearised at one shape.

    Parameters
    ----------
    membrane : Tangent
    measurements : Measurements
    prior : Prior
    pressure : (n,) array
        p₀, Pa.
    relaxation : (n, 3) array
        δ, m.
    """

    def __init__(
        self,
        membrane: Tangent,
        measurements: Measurements,
        prior: Prior,
        pressure: np.ndarray,
        relaxation: np.ndarray,
    ) -> None:
        self._membrane, self.measurements, self._prior = membrane, measurements, prior
        self._p0, self._relaxation = pressure, relaxation
        self._nodes = self._assembled = np.empty(0, int)
        self._hessian = np.empty((0, 0))
        self._position = np.full(len(pressure), -1)  # of nodes among those assembled
        self._place = self._position.copy()  # and among `_nodes`
        self._data_hessian = np.empty((0, 0))
        self._pulled = np.empty((0, len(measurements.nuisances.mean) + 1))
        """Jᵀ W of R and of the residual without contact pressure, J = D S, (assembled, a + 1)."""
        self._assembled_with, self._factor = measurements, 1.0
        """Measurements with which nodes are assembled; present weights over those of these."""
        self._weighed: np.ndarray | None = None
        """√W J of the assembled nodes, (k, assembled)."""

    @cached_property
    def _unloaded(self) -> np.ndarray:
        """Motion to equilibrium without contact pressure, (n, 3), m."""
        return self._relaxation + self._moved(self._p0)

    @cached_property
    def _error(self) -> np.ndarray:
        """Residual without contact pressure, (k,)."""
        measured = self.measurements
        return measured.error - measured.jacobian @ self._unloaded.ravel()

    @cached_property
    def _gradient_at_zero(self) -> np.ndarray:
        """Gradient of the misfit without contact pressure, (n,), 1/Pa."""
        return self._pull(self.measurements.weighed(self._error))

    def with_prior(self, mean: np.ndarray, root: np.ndarray, factor: float) -> ContactProblem:
        """The same with another prior of the nuisances, and all weights times a factor."""
        other = copy(self)
        other.measurements = self.measurements.with_prior(mean, root, factor)
        other._factor *= factor
        threshold = np.sqrt(factor) * self._prior.threshold
        other._prior = replace(self._prior, threshold=threshold)
        other._position, other._place = self._position.copy(), self._place.copy()
        other.__dict__.pop("_gradient_at_zero", None)
        if len(self._nodes):
            other._restrict_to(self._nodes)
        return other

    def zero_is_optimal(self) -> bool:
        """Whether zero contact pressure is the solution."""
        return bool((self._gradient_at_zero + self._prior.threshold >= 0.0).all())

    def select(self, start: np.ndarray, rounds: int) -> Selection:
        """Solve with the L1 term.

        Parameters
        ----------
        start : (n,) bool array
            Guess of the support.
        rounds : int
            How often nodes with a negative gradient may be added; each costs a response of the
            membrane.
        """
        prior, pivots, pressure = self._prior, 0, self._p0
        work = prior.with_neighbours(start | (pressure > 0.0))
        if not work.any():
            work = self._steepest(self._gradient_at_zero + prior.threshold)
        for _ in range(rounds):
            self._restrict_to(np.flatnonzero(work))
            linear = self._linear + prior.threshold[self._nodes]
            guess = (start | (pressure > 0.0))[self._nodes]
            if not guess.any():
                guess = linear < 0.5 * linear.min(initial=0.0)
            x, count, converged = nonnegative_qp(self._hessian, linear, guess)
            pressure = self._scatter(x)
            pivots += count
            gradient = self.gradient(pressure) + prior.threshold
            added = (gradient < -_GRADIENT_TOLERANCE * np.abs(self._linear).max()) & ~work
            if not (converged and added.any()):
                break
            work |= added
        return Selection(pressure > 0.0, pivots, converged, not added.any())

    def max_evidence(self, selection: Selection) -> Selection:
        """Support of maximal evidence near a selection (its neighbours), see `SupportProblem`.

        The L1 term penalises force, not area: it omits some nodes of a contact, which ones depends
        on the initial support.
        """
        near = self._prior.with_neighbours(selection.support)
        self._include(np.flatnonzero(near))
        problem, work = self._supports(self._nodes)
        chosen, pivots, solved = problem.max_evidence(selection.support[work])
        support = np.zeros_like(selection.support)
        support[work] = chosen
        return replace(
            selection,
            support=support,
            pivots=selection.pivots + pivots,
            converged=selection.converged and solved,
        )

    def averaged_pressure(self, pressure: np.ndarray) -> np.ndarray:
        """Mean pressure (n,), Pa, over the support of a solution and those that differ by one node.

        Where several supports are about equally likely, it hardly depends on which one was found.
        """
        support, averaged = pressure > 0.0, pressure.copy()
        if 0 < np.count_nonzero(support) <= MAX_EXCHANGE_NODES:
            near = np.flatnonzero(self._prior.with_neighbours(support))
            self._include(near)
            problem, work = self._supports(near)
            averaged[work] = problem.averaged_pressure(support[work])
        return averaged

    def _supports(self, nodes: np.ndarray) -> tuple[SupportProblem, np.ndarray]:
        """Problem of the supports within formed nodes (c,), and those of them off the rim."""
        prior = self._prior
        work = nodes[prior.smoothness.diagonal()[nodes] > 0.0]
        where = self._place[work]
        problem = SupportProblem(
            part(self._hessian, where),
            dense_part(prior.smoothness, work),
            self._linear[where],
            adjacency(prior.rings, work),
            np.count_nonzero(prior.rings[:, work] != work, axis=0),
        )
        return problem, work

    def solve_debiased(self, selection: Selection, touches: TouchRule) -> ContactPressure:
        """Solve on a support without the L1 term.

        Parameters
        ----------
        selection : Selection
        touches : TouchRule
        """
        support, pivots = selection.support, selection.pivots
        self._include(np.flatnonzero(support))
        while True:
            pressure, count, solved = self._solve_on(np.flatnonzero(support))
            pivots += count
            kept = touches(support, pressure)
            if np.array_equal(kept, support):
                break
            support = kept
        motion, measured = self._motion(pressure), self.measurements
        amplitudes = measured.amplitudes(measured.error - measured.jacobian @ motion.ravel())
        return ContactPressure(
            support,
            pressure,
            motion + measured.nuisances.moved(amplitudes),
            pivots,
            selection.converged and solved,
            selection.complete,
            amplitudes,
            self,
        )

    def with_neighbours(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes (n,) bool and their neighbours, without the rim."""
        return self._prior.with_neighbours(nodes) & (self._prior.smoothness.diagonal() > 0.0)

    def covariance(self, nodes: np.ndarray) -> np.ndarray:
        """Covariance (s + a, s + a) of pressures at nodes (s,) and amplitudes, no other contact."""
        self._include(nodes)
        amplitude_cov = self.measurements.nuisance_covariance
        pressures = np.linalg.inv(part(self._hessian, self._place[nodes]))
        slope = amplitude_cov @ self._by_nuisances(nodes).T  # of the amplitudes by pressure
        across = slope @ pressures
        return np.block([[pressures, across.T], [across, amplitude_cov + across @ slope.T]])

    def covariance_of(self, nodes: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Covariance (q, q) of quantities linear in those unknowns, coefficients (s + a, q)."""
        self._include(nodes)
        amplitude_cov, by_amplitudes = self.measurements.nuisance_covariance, unit[len(nodes) :]
        hessian = part(self._hessian, self._place[nodes])
        across = self._by_nuisances(nodes) @ amplitude_cov @ by_amplitudes
        by_pressures = unit[: len(nodes)] + across
        covariance: np.ndarray = by_pressures.T @ solve(hessian, by_pressures, assume_a="pos")
        return covariance + by_amplitudes.T @ amplitude_cov @ by_amplitudes

    def _by_nuisances(self, nodes: np.ndarray) -> np.ndarray:
        """Jᵀ W R of assembled nodes (s,), (s, a)."""
        return self._factor * self._pulled[self._position[nodes], :-1]

    def misfit_gradient(self, nodes: np.ndarray, unexplained: np.ndarray) -> np.ndarray:
        """Gradient (s, …) of the misfit by pressures of nodes (s,), for residuals (k, …), 1/Pa."""
        S = self._membrane.coordinates(nodes)
        return S.T @ (self._rows.T @ (self.measurements.weight * unexplained.T).T)

    def _solve_on(self, support: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Minimise without the L1 term over p ≥ 0 of the support only."""
        pressure = np.zeros(len(self._p0))
        if not len(support):
            return pressure, 0, True
        where = self._place[support]
        H = part(self._hessian, where)
        x, pivots, converged = nonnegative_qp(H, self._linear[where], np.ones(len(where), bool))
        pressure[support] = x
        return pressure, pivots, converged

    def _include(self, nodes: np.ndarray) -> None:
        """Form the Hessian of some nodes (c,), unless they are in it already."""
        if (self._place[nodes] < 0).any():
            self._restrict_to(nodes)

    def _restrict_to(self, work: np.ndarray) -> None:
        """Form the Hessian of the nodes `work` (c,) and the linear term."""
        self._place[self._nodes] = -1
        self._nodes, self._place[work] = work, np.arange(len(work))
        self._assemble_columns(work[self._position[work] < 0])
        where = self._position[work]
        data, by_nuisances = part(self._data_hessian, where), self._by_nuisances(work)
        self._hessian = self._factor * data + dense_part(self._prior.smoothness, work)
        covariance = self.measurements.nuisance_covariance
        self._hessian -= by_nuisances @ covariance @ by_nuisances.T
        explained = by_nuisances @ self.measurements.amplitudes(self._error)
        self._linear = self._factor * self._pulled[where, -1] - explained

    def _assemble_columns(self, nodes: np.ndarray) -> None:
        """Add the columns of the measurements' derivative by pressures of more nodes (c,)."""
        if not len(nodes):
            return
        S = self._membrane.coordinates(nodes)
        self._pulled = np.concatenate([self._pulled, S.T @ self._weighed_rows])
        weighed = self._rows @ S
        weighed *= np.sqrt(self._assembled_with.weight)[:, None]
        before = len(self._assembled)
        self._position[nodes] = before + np.arange(len(nodes))
        self._assembled = np.concatenate([self._assembled, nodes])
        among = np.empty((len(self._assembled), len(self._assembled)))
        among[:before, :before] = self._data_hessian
        among[before:, before:] = weighed.T @ weighed
        if self._weighed is not None:
            between = weighed.T @ self._weighed
            among[before:, :before], among[:before, before:] = between, between.T
            weighed = np.hstack([self._weighed, weighed])
        self._weighed, self._data_hessian = weighed, among

    @cached_property
    def _rows(self) -> sparse.csr_array:
        """D by the membrane's coordinates, (k, m)."""
        return self._membrane.by_coordinates(self._assembled_with.jacobian)

    @cached_property
    def _weighed_rows(self) -> np.ndarray:
        """Dᵀ W of R and of `_error`, by the membrane's coordinates, (m, a + 1)."""
        measured = self._assembled_with
        weighed = measured.nuisances_weighed, measured.weight * self._error
        pulled: np.ndarray = self._rows.T @ np.column_stack(weighed)
        return pulled

    def _steepest(self, gradient: np.ndarray) -> np.ndarray:
        """The nodes with the steepest gradient per area; others are added later."""
        area = self._prior.threshold  # proportional to the area
        order = np.argsort(gradient / area)
        before = np.cumsum(area[order]) - area[order]
        first = np.zeros(len(gradient), bool)
        first[order[before < _COLD_SHARE * area.sum()]] = True
        return first & (gradient < 0.0)

    def gradient(self, pressure: np.ndarray) -> np.ndarray:
        """Gradient of misfit and H1 term, (n,)."""
        moved = self.measurements.jacobian @ self._motion(pressure).ravel()
        weighed = self.measurements.weighed(self.measurements.error - moved)
        return self._pull(weighed) + self._prior.smoothness @ pressure

    def kkt_residual(self, pressure: np.ndarray) -> float:
        """KKT residual ‖min(p, ∇)‖ of a pressure (n,) on its support, without the L1 term.

        p and ∇ relative to the largest p, and ∇ without pressure, on the support.
        """
        nodes = np.flatnonzero(pressure)
        if not len(nodes):
            return 0.0
        measured = self.measurements
        moved = measured.jacobian @ self._motion(pressure).ravel()
        both = np.stack([self._error, measured.error - moved])
        weighed = np.stack([measured.weighed(each) for each in both], axis=1)
        at_zero, gradient = (self._membrane.coordinates(nodes).T @ (self._rows.T @ weighed)).T
        gradient += (self._prior.smoothness @ pressure)[nodes]
        gradient /= np.abs(at_zero).max()
        return float(np.abs(np.minimum(pressure[nodes] / pressure.max(), gradient)).max())

    def _motion(self, pressure: np.ndarray) -> np.ndarray:
        """Motion to equilibrium under a pressure (n,), (n, 3)."""
        return self._unloaded - self._moved(pressure)

    def _moved(self, pressure: np.ndarray) -> np.ndarray:
        """Motion under a pressure (n,) from inside, (n, 3)."""
        nodes = np.flatnonzero(pressure)
        if not len(nodes):
            return np.zeros_like(self._relaxation)
        return self._membrane.moved(self._membrane.coordinates(nodes) @ pressure[nodes])

    def _pull(self, weighed: np.ndarray) -> np.ndarray:
        """Derivative of the measurements by pressures, transposed, times a vector (k,)."""
        return self._membrane.adjoint((self.measurements.transposed @ weighed).reshape(-1, 3))

    def _scatter(self, x: np.ndarray) -> np.ndarray:
        pressure = np.zeros(len(self._p0))
        pressure[self._nodes] = x
        return pressure


# Which connected parts of an estimated pressure are significant contacts.


_CELL = 0.5 * sqrt(3.0)
"""Area of a node's cell over the squared length of its edges, in equilateral triangles."""


def touching_parts(
    mesh: MembraneMesh,
    support: np.ndarray,
    pressure: np.ndarray,
    least_pa: float,
    resolution_m: float,
) -> np.ndarray:
    """Parts of a support (n,) bool whose peak pressure is at least that of a touching body.

    A convex body causes a pressure p of `least_pa` or more. A load F spread evenly at p over a disc
    and blurred by ℓ has the peak p (1 − exp(−F / (2πℓ² p))). ℓ is at least half the local edge.
    """
    least_pa = max(least_pa, 1e-3)  # without gas pressure everything touches
    count, part = connected_parts(mesh.rings, support)
    found = pressure[support]
    areas = mesh.areas[support]
    load = np.bincount(part, areas * found, minlength=count)
    cell = np.bincount(part, areas, minlength=count) / np.bincount(part, minlength=count)
    blur = np.maximum(resolution_m, MESH_BLUR * np.sqrt(cell / _CELL))
    least = -least_pa * np.expm1(-load / (2.0 * np.pi * blur**2 * least_pa))
    touching = np.bincount(part, (found > 0.0) & (found >= least[part]), minlength=count) > 0.0
    kept = support.copy()
    kept[support] = touching[part]
    return kept


MISPLACED_LOAD = 0.15
"""Share of the largest contact's load that the exact membrane may misplace while a real sensor is
being loaded: in the one real press, single nodes far from the contact carry up to 0.14 of it in
frames solved without a warm start; the rest is margin. The depth camera's temporal filter mixes
images of a moving membrane, which no shape in equilibrium explains."""


def significant_contact(mesh: MembraneMesh, contact: ContactPressure) -> np.ndarray:
    """Nodes (n,) bool under pressure in significant parts of the support.

    The part with the largest load always counts. Others must carry more than `MISPLACED_LOAD` of
    its load, and more than noise causes at any of the n nodes.
    """
    count, part = connected_parts(mesh.rings, contact.support)
    nodes = np.flatnonzero(contact.support)
    load = (mesh.areas * contact.pressure)[nodes]
    loads = np.bincount(part, load, minlength=count)
    kept = loads >= MISPLACED_LOAD * loads.max(initial=0.0)
    if np.count_nonzero(kept) > 1:
        pressed = contact.pressure[nodes] > 0.0
        own = part[pressed] == np.arange(count)[:, None]  # (count, nodes under pressure)
        rows = own * mesh.areas[contact.nodes]
        covariance = contact.covariance[: len(contact.nodes), : len(contact.nodes)]
        sigma = np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows))
        least = universal_threshold(np.ones(1), len(mesh.free)) * sigma
        kept &= (loads >= least) | (loads == loads.max())
    significant = contact.pressure > 0.0
    significant[nodes] &= kept[part]
    return significant
