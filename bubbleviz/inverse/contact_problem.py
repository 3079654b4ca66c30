"""The contact pressure that explains a range image, around a shape of the exact membrane.

    min  ½ ‖e − D (δ − S Δp + B c)‖²_W + ½ λ pᵀ L p + ½ cᵀ Σ⁻¹ c + τᵀ p   over p = p₀ + Δp ≥ 0

with e the ranges that the shape leaves unexplained, D their derivative by the nodes and δ the
motion to equilibrium under the present pressure p₀. The nuisance amplitudes c, such as the error of
a measured gas pressure and the friction of each contact, have a prior and are eliminated from the
misfit. First with the L1 term to find where there is contact, then on the likeliest support there
without it, which takes out its bias.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from bubbleviz.inverse.likeliest_support import SupportProblem
from bubbleviz.inverse.solvers.pivoting import nonnegative_qp, part
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.mesh_graph import adjacency, dense_part, grown
from bubbleviz.membrane.stiffness import cotangent_laplacian

_LEAST = 40
"""Nodes that the problem of a frame without contact before it starts with."""
_SLACK = 1e-6
"""Pull below zero that counts as zero, over the largest."""


TouchRule = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Support (n,) bool and the pressure on it → what of it may be contact."""


class Response(Protocol):
    """How a membrane moves around a shape: `LinearisedRubber`, or `LinearResponse`."""

    def responses(self, nodes: np.ndarray, /) -> np.ndarray:
        """S of unit pressures from inside at nodes (c,), (3n, c), m/Pa."""

    def pull(self, force: np.ndarray, /) -> np.ndarray:
        """What unit contact pressures do against forces (n, 3), (n,)."""


@dataclass(frozen=True)
class Prior:
    """What is known of contact pressure before a frame.

    Attributes
    ----------
    smoothness : (n, n) sparse array
        λ L of the H1 term, 1/Pa².
    threshold : (n,) array
        τ of the L1 term, 1/Pa.
    rings : (d, n) int array
        Each node and its neighbours, as of `MembraneMesh`.
    """

    smoothness: sparse.csr_array
    threshold: np.ndarray
    rings: np.ndarray

    def around(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes (n,) bool and those beside them."""
        return grown(self.rings, nodes)


def smoothness(mesh: MembraneMesh, weight: float) -> sparse.csr_array:
    """λ L of a mesh, with no pressure on its rim, (n, n), for λ in 1/Pa²."""
    held = sparse.diags_array(np.where(mesh.rim, 0.0, 1.0))
    return (weight * (held @ cotangent_laplacian(mesh) @ held)).tocsr()


@dataclass(frozen=True)
class Nuisances:
    """Motions of the membrane, besides those by contact pressure, of unknown amplitudes.

    Attributes
    ----------
    motions : (n, 3, a) array
        B: motion under a unit of each, m.
    sigma : (a,) array
        Standard deviation of each amplitude, known before a frame.
    forces : (n, 3, a) array
        Contact forces on the nodes that a unit of each stands for, N.
    """

    motions: np.ndarray
    sigma: np.ndarray
    forces: np.ndarray

    @classmethod
    def none(cls, nodes: int) -> Nuisances:
        """No amplitudes at all, of a membrane with so many nodes."""
        empty = np.zeros((nodes, 3, 0))
        return cls(empty, np.zeros(0), empty)


@dataclass(frozen=True)
class Ranges:
    """What the camera says of a shape.

    Attributes
    ----------
    jacobian : (k, 3n) sparse array
        D.
    error_m : (k,) array
        e: measured less modelled ranges.
    weight : (k,) array
        1/σ².
    nuisances : Nuisances
    """

    jacobian: sparse.csr_array
    error_m: np.ndarray
    weight: np.ndarray
    nuisances: Nuisances

    @cached_property
    def transposed(self) -> sparse.csc_array:
        """Dᵀ, (3n, k)."""
        return self.jacobian.T

    @cached_property
    def by_nuisances(self) -> np.ndarray:
        """R = D B: ranges under a unit of each nuisance, (k, a), m."""
        motions = self.nuisances.motions
        return self.jacobian @ motions.reshape(3 * len(motions), motions.shape[2])

    @cached_property
    def nuisances_weighed(self) -> np.ndarray:
        """W R, (k, a)."""
        return self.weight[:, None] * self.by_nuisances

    @cached_property
    def nuisance_covariance(self) -> np.ndarray:
        """(Σ⁻¹ + RᵀWR)⁻¹: covariance of the amplitudes given everything else, (a, a)."""
        prior = np.diag(self.nuisances.sigma**-2.0)
        return np.linalg.inv(prior + self.nuisances_weighed.T @ self.by_nuisances)

    def amplitudes(self, unexplained_m: np.ndarray) -> np.ndarray:
        """Most likely amplitudes (a,) for ranges (k,) that nothing else explains."""
        return self.nuisance_covariance @ (self.nuisances_weighed.T @ unexplained_m)

    def weighed(self, ranges_m: np.ndarray) -> np.ndarray:
        """Ranges (k,) times the inverse of their covariance, the nuisances in it (Woodbury)."""
        return self.weight * ranges_m - self.nuisances_weighed @ self.amplitudes(ranges_m)


@dataclass(frozen=True)
class Selection:
    """Where there is contact.

    Attributes
    ----------
    support : (n,) bool array
    pivots : int
        Of the solver, to find it.
    converged : bool
    complete : bool
        No node outside it pulls.
    """

    support: np.ndarray
    pivots: int = 0
    converged: bool = True
    complete: bool = True


@dataclass(frozen=True)
class ContactPressure:
    """Solution of a problem.

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
    kkt_residual : float
        ‖min(p, ∇)‖ of the debiased problem on its support, both over their largest.
    nodes : (s,) int array
        Those under pressure.
    amplitudes : (a,) array
        Of the nuisances.
    covariance : (s + a, s + a) array
        Of the pressures of `nodes`, Pa, and the amplitudes.
    """

    support: np.ndarray
    pressure: np.ndarray
    motion: np.ndarray
    pivots: int
    converged: bool
    complete: bool
    kkt_residual: float
    nodes: np.ndarray
    amplitudes: np.ndarray
    covariance: np.ndarray


class ContactProblem:
    """The problem of one frame around one shape.

    Parameters
    ----------
    membrane : Response
    ranges : Ranges
    prior : Prior
    pressure : (n,) array
        p₀, Pa.
    relaxing : (n, 3) array
        δ, m.
    """

    def __init__(
        self,
        membrane: Response,
        ranges: Ranges,
        prior: Prior,
        pressure: np.ndarray,
        relaxing: np.ndarray,
    ) -> None:
        self._membrane, self._ranges, self._prior = membrane, ranges, prior
        self._before, self._relaxing = pressure, relaxing
        left = ranges.error_m - ranges.jacobian @ relaxing.ravel()
        self._at_before = self._pull(left)
        """Gradient of the misfit at p₀, (n,), 1/Pa."""
        self._work = self._known = np.empty(0, int)
        self._hessian = np.empty((0, 0))
        self._place = np.full(len(pressure), -1)
        self._among_known = np.empty((0, 0))
        self._by_nuisances = np.empty((0, len(ranges.nuisances.sigma)))
        """Jᵀ W R of the known nodes, with J = D S, (known, a)."""
        self._weighed = np.empty((len(ranges.weight), 0))
        """√W D S of the known nodes, (k, known)."""

    def nothing_pulls(self) -> bool:
        """Whether no contact pressure at all is the solution; for p₀ = 0."""
        return bool((self._at_before + self._prior.threshold >= 0.0).all())

    def select(self, start: np.ndarray, rounds: int) -> Selection:
        """Solve with the L1 term.

        Parameters
        ----------
        start : (n,) bool array
            Guess of the support.
        rounds : int
            How often nodes that pull may be added to it; each costs a response of the membrane.
        """
        prior, pivots = self._prior, 0
        gradient = self._gradient(self._before) + prior.threshold
        work = prior.around(start | (self._before > 0.0)) | self._strongest(gradient, start)
        pressure = self._before
        for _ in range(rounds):
            self._set(np.flatnonzero(work))
            guess = (start | (pressure > 0.0))[self._work]
            if not guess.any():
                slope = gradient[self._work]
                guess = slope < 0.5 * slope.min(initial=0.0)
            linear = self._linear + prior.threshold[self._work]
            x, count, converged = nonnegative_qp(self._hessian, linear, guess)
            pressure = self._everywhere(x)
            pivots += count
            gradient = self._gradient(pressure) + prior.threshold
            pulled = (gradient < -_SLACK * np.abs(self._linear).max()) & ~work
            if not (converged and pulled.any()):
                break
            work |= prior.around(pulled)
        return Selection(pressure > 0.0, pivots, converged, not pulled.any())

    def likeliest(self, selection: Selection) -> Selection:
        """The likeliest support within one node of a selection, see `SupportProblem`.

        The L1 term counts force, not area: it leaves nodes out, and others from another start.
        """
        prior = self._prior
        near = prior.around(selection.support)
        if not np.isin(np.flatnonzero(near), self._work).all():
            self._set(np.flatnonzero(near))
        inner = np.flatnonzero(prior.smoothness.diagonal()[self._work] > 0.0)  # not of the rim
        work = self._work[inner]
        problem = SupportProblem(
            part(self._hessian, inner),
            dense_part(prior.smoothness, work),
            self._linear[inner],
            adjacency(prior.rings, work),
            np.count_nonzero(prior.rings[:, work] != work, axis=0),
        )
        chosen, pivots, solved = problem.likeliest(selection.support[work])
        support = np.zeros_like(selection.support)
        support[work] = chosen
        return replace(
            selection,
            support=support,
            pivots=selection.pivots + pivots,
            converged=selection.converged and solved,
        )

    def refine(self, selection: Selection, touches: TouchRule) -> ContactPressure:
        """Solve on a support without the L1 term.

        Parameters
        ----------
        selection : Selection
        touches : TouchRule
        """
        support, pivots = selection.support, selection.pivots
        missing = support.copy()
        missing[self._work] = False
        if missing.any():
            self._set(np.flatnonzero(support))
        while True:
            pressure, count, solved = self._on(np.flatnonzero(support))
            pivots += count
            kept = touches(support, pressure)
            if np.array_equal(kept, support):
                break
            support = kept
        nodes = np.flatnonzero(pressure > 0.0)
        motion, ranges = self._motion(pressure), self._ranges
        amplitudes = ranges.amplitudes(ranges.error_m - ranges.jacobian @ motion.ravel())
        return ContactPressure(
            support,
            pressure,
            motion + ranges.nuisances.motions @ amplitudes,
            pivots,
            selection.converged and solved,
            selection.complete,
            self._kkt(pressure, support) if support.any() else 0.0,
            nodes,
            amplitudes,
            self._covariance(nodes),
        )

    def _covariance(self, nodes: np.ndarray) -> np.ndarray:
        """Covariance of the pressures of nodes (s,) and of the amplitudes, (s + a, s + a)."""
        alone = self._ranges.nuisance_covariance
        pressures = np.linalg.inv(part(self._hessian, np.searchsorted(self._work, nodes)))
        slope = alone @ self._by_nuisances[self._place[nodes]].T  # of the amplitudes by pressure
        across = slope @ pressures
        return np.block([[pressures, across.T], [across, alone + across @ slope.T]])

    def _on(self, support: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Minimise without the L1 term over p ≥ 0 of the support alone."""
        pressure = np.zeros(len(self._before))
        if not len(support):
            return pressure, 0, True
        where = np.searchsorted(self._work, support)
        H = part(self._hessian, where)
        x, pivots, converged = nonnegative_qp(H, self._linear[where], np.ones(len(where), bool))
        pressure[support] = x
        return pressure, pivots, converged

    def _set(self, work: np.ndarray) -> None:
        """Form the Hessian of the nodes `work` (c,) and the linear term."""
        self._work = work
        self._know(work[~np.isin(work, self._known)])
        where = self._place[work]
        self._hessian = part(self._among_known, where) + dense_part(self._prior.smoothness, work)
        by_nuisances = self._by_nuisances[where]
        self._hessian -= by_nuisances @ self._ranges.nuisance_covariance @ by_nuisances.T
        gradient = self._gradient(self._before)[work]
        self._linear = gradient - self._hessian @ self._before[work]

    def _know(self, nodes: np.ndarray) -> None:
        """Find what the pressures of some more nodes (c,) do to the ranges."""
        if not len(nodes):
            return
        J = self._ranges.jacobian @ self._membrane.responses(nodes)
        by_nuisances = J.T @ self._ranges.nuisances_weighed
        self._by_nuisances = np.concatenate([self._by_nuisances, by_nuisances])
        J *= np.sqrt(self._ranges.weight)[:, None]
        before = len(self._known)
        self._place[nodes] = before + np.arange(len(nodes))
        self._known = np.concatenate([self._known, nodes])
        between = J.T @ self._weighed
        among = np.empty((len(self._known), len(self._known)))
        among[:before, :before] = self._among_known
        among[before:, :before], among[:before, before:] = between, between.T
        among[before:, before:] = J.T @ J  # by itself: half the work
        self._weighed = np.hstack([self._weighed, J]) if before else J
        self._among_known = among

    def _strongest(self, gradient: np.ndarray, start: np.ndarray) -> np.ndarray:
        """As many of the nodes that pull most as the start has; the others come later."""
        most = min(int(np.count_nonzero(start)) or _LEAST, len(gradient) - 1)
        return gradient < min(0.0, np.partition(gradient, most)[most])

    def _gradient(self, pressure: np.ndarray) -> np.ndarray:
        """Gradient of misfit and H1 term, (n,)."""
        data = self._at_before
        if pressure is not self._before:
            moved = self._motion(pressure) - self._relaxing
            data = data - self._pull(self._ranges.jacobian @ moved.ravel())
        return data + self._prior.smoothness @ pressure

    def _kkt(self, pressure: np.ndarray, support: np.ndarray) -> float:
        gradient = (self._hessian @ pressure[self._work] + self._linear)[support[self._work]]
        scale = float(np.abs(self._linear).max())
        share = pressure[support] / max(float(pressure.max()), 1e-300)
        return float(np.abs(np.minimum(share, gradient / scale)).max())

    def _motion(self, pressure: np.ndarray) -> np.ndarray:
        """Motion to equilibrium under a pressure (n,), (n, 3)."""
        change = pressure - self._before
        if not change.any():
            return self._relaxing
        nodes = np.flatnonzero(change)
        return self._relaxing - (self._membrane.responses(nodes) @ change[nodes]).reshape(-1, 3)

    def _pull(self, ranges_m: np.ndarray) -> np.ndarray:
        weighted = self._ranges.transposed @ self._ranges.weighed(ranges_m)
        return self._membrane.pull(weighted.reshape(-1, 3))

    def _everywhere(self, x: np.ndarray) -> np.ndarray:
        pressure = np.zeros(len(self._before))
        pressure[self._work] = x
        return pressure
