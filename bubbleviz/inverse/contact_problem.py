"""The contact pressure that explains a range image, around a shape of the exact membrane.

    min  ½ ‖e − D (δ − S Δp) − R c‖²_W + ½ λ pᵀ L p + ½ cᵀ Σ⁻¹ c + τᵀ p   over p = p₀ + Δp ≥ 0

with e the ranges that the shape leaves unexplained, D their derivative by the nodes and δ the
motion to equilibrium under the present pressure p₀. The nuisance amplitudes c (errors of a measured
gas pressure and of the whole image, friction of each contact) change the ranges by R c; they have a
prior and are eliminated from the misfit. First with the L1 term to find where there is contact,
then on the likeliest support there without it, which takes out its bias.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import log

import numpy as np
from scipy import sparse
from scipy.linalg import solve
from scipy.linalg.blas import dger

from bubbleviz.inverse.pivoting import nonnegative_qp, part
from bubbleviz.inverse.resolution import universal_threshold
from bubbleviz.inverse.response import Tangent
from bubbleviz.membrane import (
    MembraneMesh,
    adjacency,
    connected_parts,
    cotangent_laplacian,
    dense_part,
    grown,
)

# Which nodes touch: the support that explains a frame best, whatever support it was started from.
#
# The pressure p on a support S has the prior N(0, (λ L_SS)⁻¹), so that the evidence of S (MacKay
# 1992) is, but for a constant,
#
#     −min ½ pᵀHp + fᵀp + ½ ln det λL_SS − ½ ln det H_SS − β |∂S|,
#
# with H and f those of the debiased problem and |∂S| the mesh edges between S and the rest: of all
# supports those with a short boundary are the likely ones. Nodes are exchanged one at a time, the
# one that gains most first, until none gains.


_CUT = 0.5 * log(2.0)
"""β: a boundary has some two ways to go on at every node, and two mesh edges cut beside it."""
_GAIN = 1e-6
"""Least gain of an exchange, so that rounding does not repeat one for ever."""


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

    def likeliest(self, start: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Support (c,) bool that no exchange of a node betters, pivots, and whether it converged.

        Parameters
        ----------
        start : (c,) bool array
        """
        support, pivots, solved = self._pressed(start)
        posterior = _Swept(np.block([[self.hessian, self.linear[:, None]], [self.linear, 0.0]]))
        prior = _Swept(self.smoothness)
        for _ in range(len(start)):
            if not (solved and support.any()):
                break
            posterior.sweep(support)
            prior.sweep(support)
            if (posterior.matrix[:-1, -1][support] >= 0.0).any():  # −p: some do not press
                support, count, solved = self._pressed(support)
                pivots += count
                continue
            gain = self._gain(support, posterior.matrix, prior.matrix)
            best = int(np.argmax(gain))
            if gain[best] <= _GAIN:
                break
            support = support.copy()
            support[best] ^= True
            pivots += 1
        return support, pivots, solved

    def _pressed(self, support: np.ndarray) -> tuple[np.ndarray, int, bool]:
        """Nodes of a support (c,) bool under pressure, pivots, and whether it converged."""
        nodes = np.flatnonzero(support)
        H = part(self.hessian, nodes)
        p, pivots, solved = nonnegative_qp(H, self.linear[nodes], np.ones(len(nodes), bool))
        pressed = np.zeros_like(support)
        pressed[nodes[p > 0.0]] = True
        return (pressed if solved else support), pivots, solved

    def _gain(self, support: np.ndarray, posterior: np.ndarray, prior: np.ndarray) -> np.ndarray:
        """By how much the evidence rises where a node (c,) is taken out of the support or in."""
        slope = posterior[:-1, -1]  # −p of the support, the gradient of the others
        precision, prior_precision = np.diag(posterior)[:-1], np.diag(prior)
        # Both are negative on the support; of different signs only where rounding lost them.
        sound = (prior_precision > 0.0) == (precision > 0.0)
        shrink = np.where(sound, prior_precision / precision, 1.0)
        gain = 0.5 * np.log(shrink) + 0.5 * slope**2 / precision
        gain[~sound | (~support & (slope >= 0.0))] = -np.inf
        added_cuts = self.degree - 2.0 * self.neighbours[:, support].sum(axis=1)
        return gain + np.where(support, _CUT, -_CUT) * added_cuts


class _Swept:
    """A symmetric matrix solved for some of its unknowns, one more or less at a time.

    Swept by a set S (Goodnight 1979), M becomes −M_SS⁻¹ there, the Schur complement among the
    others, and M_SS⁻¹ M_S· between.

    Parameters
    ----------
    matrix : (c, c) array
    """

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = np.array(matrix, order="F")
        self._swept = np.zeros(len(matrix), bool)

    def sweep(self, unknowns: np.ndarray) -> None:
        """Have it swept by these (up to c,) bool, and by no others."""
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
        """The same at once, for a matrix not swept yet."""
        S, others = np.flatnonzero(wanted), np.flatnonzero(~wanted)
        between = self.matrix[np.ix_(S, others)]
        inverse = np.linalg.inv(part(self.matrix, S))
        solved = inverse @ between
        self.matrix[np.ix_(S, S)] = -inverse
        self.matrix[np.ix_(S, others)] = solved
        self.matrix[np.ix_(others, S)] = solved.T
        self.matrix[np.ix_(others, others)] -= between.T @ solved
        self._swept = wanted


_LEAST = 40
"""Nodes that the problem of a frame without contact before it starts with."""
_SLACK = 1e-6
"""Pull below zero that counts as zero, over the largest."""


TouchRule = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Support (n,) bool and the pressure on it → what of it may be contact."""


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
    """What changes the ranges besides contact pressure, each by an unknown amplitude.

    Attributes
    ----------
    motions : (n, 3, a) array
        B: motion of the membrane under a unit of each, m.
    sigma : (a,) array
        Standard deviation of each amplitude, known before a frame; 0 for one that is not free.
    forces : (n, 3, a) array
        Contact forces on the nodes that a unit of each stands for, N.
    errors_m : (k, a) array
        E: error of the measured ranges under a unit of each.
    """

    motions: np.ndarray
    sigma: np.ndarray
    forces: np.ndarray
    errors_m: np.ndarray

    @classmethod
    def none(cls, nodes: int) -> Nuisances:
        """No amplitudes at all, of a membrane with so many nodes."""
        empty = np.zeros((nodes, 3, 0))
        return cls(empty, np.zeros(0), empty, np.zeros((1, 0)))

    @classmethod
    def of_motions(
        cls, motions: np.ndarray, sigma: np.ndarray, forces: np.ndarray, ranges: int
    ) -> Nuisances:
        """Motions that so many ranges show without error."""
        return cls(motions, sigma, forces, np.zeros((ranges, len(sigma))))

    @classmethod
    def of_image(cls, errors_m: np.ndarray, sigma: np.ndarray, nodes: int) -> Nuisances:
        """Errors of an image of a membrane with so many nodes."""
        nothing = np.zeros((nodes, 3, len(sigma)))
        return cls(nothing, sigma, nothing, errors_m)

    @classmethod
    def joined(cls, parts: Sequence[Nuisances]) -> Nuisances:
        """All of several, in their order."""
        return cls(
            np.concatenate([part.motions for part in parts], axis=2),
            np.concatenate([part.sigma for part in parts]),
            np.concatenate([part.forces for part in parts], axis=2),
            np.concatenate([part.errors_m for part in parts], axis=1),
        )


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
        """R = D B + E: ranges under a unit of each nuisance, (k, a), m."""
        motions = self.nuisances.motions
        moved = self.jacobian @ motions.reshape(3 * len(motions), motions.shape[2])
        return moved + self.nuisances.errors_m

    @cached_property
    def nuisances_weighed(self) -> np.ndarray:
        """W R, (k, a)."""
        return self.weight[:, None] * self.by_nuisances

    @cached_property
    def nuisance_covariance(self) -> np.ndarray:
        """(Σ⁻¹ + RᵀWR)⁻¹: covariance of the amplitudes given everything else, (a, a)."""
        sigma = np.diag(self.nuisances.sigma)  # may have zeros
        data = self.nuisances_weighed.T @ self.by_nuisances
        scaled = np.linalg.inv(np.eye(len(sigma)) + sigma @ data @ sigma)
        return np.asarray(sigma @ scaled @ sigma)

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
    amplitudes : (a,) array
        Of the nuisances.
    problem : ContactProblem
        That this solves.
    """

    support: np.ndarray
    pressure: np.ndarray
    motion: np.ndarray
    pivots: int
    converged: bool
    complete: bool
    kkt_residual: float
    amplitudes: np.ndarray
    problem: ContactProblem

    @cached_property
    def nodes(self) -> np.ndarray:
        """Those under pressure, (s,)."""
        return np.flatnonzero(self.pressure)

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the pressures of `nodes`, Pa, and the amplitudes, (s + a, s + a), on this support."""
        return self.problem.covariance(self.nodes)


class ContactProblem:
    """The problem of one frame around one shape.

    Parameters
    ----------
    membrane : Tangent
    ranges : Ranges
    prior : Prior
    pressure : (n,) array
        p₀, Pa.
    relaxing : (n, 3) array
        δ, m.
    """

    def __init__(
        self,
        membrane: Tangent,
        ranges: Ranges,
        prior: Prior,
        pressure: np.ndarray,
        relaxing: np.ndarray,
    ) -> None:
        self._membrane, self._ranges, self._prior = membrane, ranges, prior
        self._before, self._relaxing = pressure, relaxing
        self._work = self._known = np.empty(0, int)
        self._hessian = np.empty((0, 0))
        self._place = np.full(len(pressure), -1)
        self._among_known = np.empty((0, 0))
        self._by_nuisances = np.empty((0, len(ranges.nuisances.sigma)))
        """Jᵀ W R of the known nodes, with J = D S, (known, a)."""
        self._weighed: np.ndarray | None = None
        """Of the known nodes, see `_halves`."""

    @cached_property
    def _at_before(self) -> np.ndarray:
        """Gradient of the misfit at p₀, (n,), 1/Pa."""
        relaxed = self._ranges.jacobian @ self._relaxing.ravel()
        return self._pull(self._ranges.error_m - relaxed)

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
        gradient = self.gradient(self._before) + prior.threshold
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
            gradient = self.gradient(pressure) + prior.threshold
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
            amplitudes,
            self,
        )

    def around(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes (n,) bool and those beside them that are not held."""
        return self._prior.around(nodes) & (self._prior.smoothness.diagonal() > 0.0)

    def covariance(self, nodes: np.ndarray) -> np.ndarray:
        """Of the pressures of nodes (s,) and the amplitudes, if no others touch, (s + a, s + a)."""
        if not np.isin(nodes, self._work).all():
            self._set(nodes)
        alone = self._ranges.nuisance_covariance
        pressures = np.linalg.inv(part(self._hessian, np.searchsorted(self._work, nodes)))
        slope = alone @ self._by_nuisances[self._place[nodes]].T  # of the amplitudes by pressure
        across = slope @ pressures
        return np.block([[pressures, across.T], [across, alone + across @ slope.T]])

    def variance(self, nodes: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Of a force (3,) of those unknowns with unit forces (s + a, 3), N²."""
        if not np.isin(nodes, self._work).all():
            self._set(nodes)
        alone, by_amplitudes = self._ranges.nuisance_covariance, force[len(nodes) :]
        hessian = part(self._hessian, np.searchsorted(self._work, nodes))
        unit = force[: len(nodes)] + self._by_nuisances[self._place[nodes]] @ alone @ by_amplitudes
        variance: np.ndarray = (unit * solve(hessian, unit, assume_a="pos")).sum(axis=0)
        return variance + (by_amplitudes * (alone @ by_amplitudes)).sum(axis=0)

    def pulled(self, nodes: np.ndarray, ranges_m: np.ndarray) -> np.ndarray:
        """Gradient of the misfit by the pressures of nodes (s,), for ranges (k,) left, 1/Pa."""
        S = self._membrane.coordinates(nodes)
        return S.T @ (self._rows.T @ self._ranges.weighed(ranges_m))

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
        gradient = self.gradient(self._before)[work]
        self._linear = gradient - self._hessian @ self._before[work]

    def _know(self, nodes: np.ndarray) -> None:
        """Find what the pressures of some more nodes (c,) do to the ranges."""
        if not len(nodes):
            return
        S = self._membrane.coordinates(nodes)
        by_nuisances = S.T @ (self._rows.T @ self._ranges.nuisances_weighed)
        self._by_nuisances = np.concatenate([self._by_nuisances, by_nuisances])
        half, weighed = self._halves(S)
        before = len(self._known)
        self._place[nodes] = before + np.arange(len(nodes))
        self._known = np.concatenate([self._known, nodes])
        among = np.empty((len(self._known), len(self._known)))
        among[:before, :before] = self._among_known
        among[before:, before:] = half.T @ weighed
        if self._weighed is not None:
            between = half.T @ self._weighed
            among[before:, :before], among[:before, before:] = between, between.T
            weighed = np.hstack([self._weighed, weighed])
        self._weighed, self._among_known = weighed, among

    @cached_property
    def _rows(self) -> sparse.csr_array:
        """D by the membrane's coordinates, (k, m)."""
        return self._membrane.by_coordinates(self._ranges.jacobian)

    @cached_property
    def _information(self) -> sparse.csr_array | None:
        """Dᵀ W D, (m, m); None where D has hardly more rows than that."""
        rows = self._rows
        if rows.shape[0] < 2 * rows.shape[1]:
            return None
        return (rows.T @ sparse.diags_array(self._ranges.weight) @ rows).tocsr()

    def _halves(self, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Two matrices (…, c) for motions S (m, c), the first of which times the second is SᵀDᵀWDS.

        They are S and DᵀWDS, or twice √W D S: whichever is smaller.
        """
        if self._information is not None:
            return S, self._information @ S
        seen = self._rows @ S
        seen *= np.sqrt(self._ranges.weight)[:, None]
        return seen, seen

    def _strongest(self, gradient: np.ndarray, start: np.ndarray) -> np.ndarray:
        """As many of the nodes that pull most as the start has; the others come later."""
        most = min(int(np.count_nonzero(start)) or _LEAST, len(gradient) - 1)
        return gradient < min(0.0, np.partition(gradient, most)[most])

    def gradient(self, pressure: np.ndarray) -> np.ndarray:
        """Gradient of misfit and H1 term, (n,)."""
        data = self._at_before
        if pressure is not self._before:
            moved = self._motion(pressure) - self._relaxing
            data = data - self._pull(self._ranges.jacobian @ moved.ravel())
        return data + self._prior.smoothness @ pressure

    def kkt_residual(self, pressure: np.ndarray) -> float:
        """‖min(p, ∇)‖ of a pressure (n,) on its own support without the L1 term; both relative."""
        where = pressure > 0.0
        if not where.any():
            return 0.0
        scale = float(np.abs(self._at_before).max())
        gradient = self.gradient(pressure)[where] / scale
        return float(np.abs(np.minimum(pressure[where] / pressure.max(), gradient)).max())

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
        return self._relaxing - self._membrane.moved(
            self._membrane.coordinates(nodes) @ change[nodes]
        )

    def _pull(self, ranges_m: np.ndarray) -> np.ndarray:
        weighted = self._ranges.transposed @ self._ranges.weighed(ranges_m)
        return self._membrane.pull(weighted.reshape(-1, 3))

    def _everywhere(self, x: np.ndarray) -> np.ndarray:
        pressure = np.zeros(len(self._before))
        pressure[self._work] = x
        return pressure


# Which connected parts of an estimated pressure are contact, each by evidence of its own.


MISPLACED_LOAD = 0.15
"""Share of the largest contact's load that the exact membrane misplaces on a real sensor while it
is being loaded: in the one real press, single nodes far from the contact carry up to 0.14 of it in
frames that are solved by themselves; the rest is margin. The depth camera's temporal filter mixes
images of a moving membrane, which no shape in equilibrium explains."""


def _substantial(mesh: MembraneMesh, pressure: np.ndarray) -> np.ndarray:
    """Nodes (n,) bool of the parts of a pressure (n,) that carry more than the misplaced load."""
    touching = pressure > 0.0
    count, part = connected_parts(mesh.rings, touching)
    loads = np.bincount(part, (mesh.areas * pressure)[touching], minlength=count)
    touching[touching] = (loads >= MISPLACED_LOAD * loads.max(initial=0.0))[part]
    return touching


def evident(mesh: MembraneMesh, contact: ContactPressure) -> np.ndarray:
    """Nodes (n,) bool of the parts that are contact; the part with the largest load always is one.

    Another one has to be substantial, and to carry more than noise puts at any of the n nodes.
    """
    found = _substantial(mesh, contact.pressure)
    count, part = connected_parts(mesh.rings, found)
    if count < 2:
        return found
    nodes = np.flatnonzero(found)
    own = part == np.arange(count)[:, None]  # (count, nodes)
    loads, rows = own @ (mesh.areas * contact.pressure)[nodes], own * mesh.areas[nodes]
    where = np.searchsorted(contact.nodes, nodes)
    covariance = contact.covariance[np.ix_(where, where)]
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows))
    kept = [
        load >= universal_threshold(each, len(mesh.free))
        for load, each in zip(loads, sigma, strict=True)
    ]
    kept[np.argmax(loads)] = True
    found[nodes] = np.array(kept)[part]
    return found


# Friction of contacts that a depth image alone determines.
#
# A depth image does not show friction, but friction moves the membrane: without it, the estimate
# would explain that motion by pressure where nothing touches. Each contact has three unknowns:
# slides along two directions across its mean normal, and a spin about it. Each is a traction
# proportional to the contact pressure, so that its amplitude is the share of Coulomb's friction
# that acts.


FRICTION = 1.0
"""Standard deviation of the amplitudes: dry latex on common materials has coefficients of friction
between 0.5 and 1.5. On rubber dragged and twisted by another solver, half and twice of it change
the force by 0.2 % in the median and 2.4 % at most at 1 % of depth noise."""

_LEAST_SHARE = 0.25
"""Share of the largest contact's load from which a contact has amplitudes of its own. While the
real press is being loaded, those of single nodes with a tenth of it fitted what the model misses
there, and the solution alternated between two supports."""


def friction_loads(
    x: np.ndarray, area_vectors: np.ndarray, pressure: np.ndarray, rings: np.ndarray
) -> np.ndarray:
    """Forces on the nodes under a unit of each amplitude, (n, 3, 3 contacts), N.

    Contacts that are small beside the largest have no amplitudes.

    Parameters
    ----------
    x : (n, 3) array
        Shape, m.
    area_vectors : (n, 3) array
        Of its nodes, m².
    pressure : (n,) array
        p_c, Pa; connected nodes under pressure are a contact.
    rings : (d, n) int array
        As of `MembraneMesh`.
    """
    touching = pressure > 0.0
    count, contact = connected_parts(rings, touching)
    nodes = np.flatnonzero(touching)
    load = pressure[nodes] * np.linalg.norm(area_vectors[nodes], axis=1)
    loads = np.bincount(contact, load, minlength=count)
    large = np.flatnonzero(loads >= _LEAST_SHARE * loads.max())
    forces = np.zeros((len(x), 3, 3 * len(large)))
    for k, number in enumerate(large):
        own = nodes[contact == number]
        forces[own, :, 3 * k : 3 * k + 3] = _loads(x[own], area_vectors[own], pressure[own])
    return forces


def _loads(x: np.ndarray, area_vectors: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """Two slides and a spin of one contact of c nodes, (c, 3, 3), N."""
    area = np.linalg.norm(area_vectors, axis=1, keepdims=True)
    load, normal = pressure * area[:, 0], area_vectors / area
    axis = load @ normal
    axis /= np.linalg.norm(axis)
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    spin = np.cross(axis, x - load @ x / load.sum())
    radius = np.sqrt(load @ (spin**2).sum(axis=1) / load.sum())  # 0 of a single node
    spin /= max(radius, np.finfo(float).tiny)
    slides = np.stack([first, np.cross(axis, first)], axis=1)
    along = np.concatenate([np.broadcast_to(slides, (len(x), 3, 2)), spin[:, :, None]], axis=2)
    along = along - normal[:, :, None] * np.einsum("ci,cij->cj", normal, along)[:, None]
    return load[:, None, None] * along
