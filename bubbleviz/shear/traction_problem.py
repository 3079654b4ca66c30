"""The contact traction that explains ranges and flow, linearised at a shape of the membrane.

    min  ½ ‖e − D (δ − S a Δp + S t Δq + b g)‖²_W + ½ λ pᵀ L p + ½ Λ qᵀ L q + ½ (g/σ_g)²

over the pressure p ≥ 0, the tangential traction q and the error g of a measured gas pressure, on
the support of a contact. The smoothness weight of q, Λ, maximises the evidence (MacKay 1992): shear
may be zero everywhere, smooth, or concentrated at the edge of the contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve, eigh

from bubbleviz.inverse import nonnegative_qp, part

# Coulomb's bound on the tangential traction, as a cone programme.


_ZERO_PRESSURE = 1e-4
"""Pressure over the largest below which the interior point solution counts as 0."""


def within_cone(
    H: np.ndarray,  # (c, c)
    linear: np.ndarray,  # (c,), b
    nodes: int,  # s: x is p (s,), q (2s,) and unbounded unknowns
    friction: float,  # μ
) -> tuple[np.ndarray, bool]:
    """Minimise ½ xᵀHx − bᵀx with |q| ≤ μ p at every node; also whether it converged."""
    import clarabel  # only where friction is bounded

    scale = 1.0 / float(H.diagonal().mean())
    size = len(linear)
    rows = np.arange(3 * nodes)
    columns = np.column_stack(
        [np.arange(nodes), nodes + 2 * np.arange(nodes), nodes + 2 * np.arange(nodes) + 1]
    ).ravel()
    values = -np.tile([friction, 1.0, 1.0], nodes)
    cone = sparse.csc_matrix((values, (rows, columns)), shape=(3 * nodes, size))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    result = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(H) * scale),
        -linear * scale,
        cone,
        np.zeros(3 * nodes),
        [clarabel.SecondOrderConeT(3)] * nodes,
        settings,
    ).solve()
    x = np.asarray(result.x)
    unloaded = x[:nodes] <= _ZERO_PRESSURE * x[:nodes].max()
    x[: 3 * nodes][np.concatenate([unloaded, np.repeat(unloaded, 2)])] = 0.0
    return x, result.status == clarabel.SolverStatus.Solved


_DECADES = np.linspace(-8.0, 8.0, 129)
"""log₁₀ of the Λ/λ that are compared."""


@dataclass(frozen=True)
class Unknowns:
    """Unknowns on a support of s nodes."""

    pressure: np.ndarray  # (s,), p, Pa
    shear: np.ndarray  # (2s,), q: traction along the two tangents of each node, Pa
    gas_error_pa: float  # g


@dataclass(frozen=True)
class Measurements:
    """Ranges and flow, one after the other."""

    jacobian: sparse.csr_array  # (k, 3n) sparse
    error: np.ndarray  # (k,), m, then pixels
    weight: np.ndarray  # (k,), 1/σ²


@dataclass(frozen=True)
class SolvedTraction:
    """Solution of a problem."""

    unknowns: Unknowns
    motion: np.ndarray  # (n, 3), to first order, m
    factor: tuple[np.ndarray, bool]  # Cholesky factor of the Hessian of the columns `active`
    active: np.ndarray  # (c,) int, free unknowns among p, q and g in this order
    columns: np.ndarray  # (3n, c), motions under unit p, q and g
    measurements: Measurements
    weighted: np.ndarray  # (k, c), effect of the columns on the measurements over their σ
    converged: bool

    def response(self, motions: np.ndarray) -> np.ndarray:
        """Changes of the `active` unknowns if the membrane is displaced by motions (3n, k)."""
        measured = self.measurements
        weighted = np.sqrt(measured.weight)[:, None] * (measured.jacobian @ motions)
        gradient = (self.weighted.T @ weighted)[self.active]
        change: np.ndarray = cho_solve(self.factor, gradient, check_finite=False)
        return change


class TractionProblem:
    """The problem of one frame, linearised at one shape."""

    def __init__(
        self,
        # (3n, c), motions under unit p, q and, where it is measured, gas pressure, in this order
        columns: np.ndarray,
        relaxation: np.ndarray,  # (n, 3), δ: motion to equilibrium under the present traction, m
        measurements: Measurements,
        smoothness: np.ndarray,  # (s, s), λ L on the support, 1/Pa²
        present: Unknowns,
        gas_sigma_pa: float | None,  # None: gas pressure by the volume
    ) -> None:
        self._columns, self._relaxation, self._smoothness = columns, relaxation, smoothness
        self._size, self._measurements = len(smoothness), measurements
        m = measurements
        unexplained = m.error - m.jacobian @ relaxation.ravel()
        J = m.jacobian @ columns
        self._linear = J.T @ (m.weight * unexplained)
        J *= np.sqrt(m.weight)[:, None]
        self._weighted, self._data = J, J.T @ J
        gas = [] if gas_sigma_pa is None else [present.gas_error_pa]
        self._present = np.concatenate([present.pressure, present.shear, gas])
        self._linear += self._data @ self._present
        self._prior = np.zeros_like(self._data)
        s = self._size
        self._prior[:s, :s] = smoothness
        if gas_sigma_pa is not None:
            self._prior[-1, -1] = 1.0 / gas_sigma_pa**2
        self._shear = np.arange(s, 3 * s)
        self._shear_smoothness = np.kron(smoothness, np.eye(2))

    def solve(
        self,
        friction: float | None = None,  # bound μ of the tangential over the normal traction
    ) -> SolvedTraction:
        """Most likely traction."""
        s = self._size
        weight = self._max_evidence_weight()
        H = self._data + self._prior
        H[np.ix_(self._shear, self._shear)] += weight * self._shear_smoothness
        if friction is not None:
            x, converged = within_cone(H, self._linear, s, friction)
        else:
            x, converged = self._nonnegative(H)
        active = self._active(x[:s] > 0.0)
        factor = cho_factor(part(H, active), lower=True, check_finite=False)
        motion = (self._columns @ (x - self._present)).reshape(-1, 3) + self._relaxation
        gas = float(x[-1]) if len(x) > 3 * s else 0.0
        return SolvedTraction(
            Unknowns(x[:s], x[s : 3 * s], gas),
            motion,
            factor,
            active,
            self._columns,
            self._measurements,
            self._weighted,
            converged,
        )

    def _active(self, touching: np.ndarray) -> np.ndarray:
        gas = np.ones(len(self._present) - 3 * self._size, bool)
        return np.flatnonzero(np.concatenate([touching, np.repeat(touching, 2), gas]))

    def _nonnegative(self, H: np.ndarray) -> tuple[np.ndarray, bool]:
        """Minimise with p ≥ 0, and q = 0 where p = 0."""
        s, x, converged = self._size, np.zeros(len(H)), True
        touching = np.ones(s, bool)
        while touching.any():
            active = self._active(touching)
            count = int(np.count_nonzero(touching))
            K, f = part(H, active), self._linear[active]
            rest = cho_factor(K[count:, count:], lower=True, check_finite=False)
            across = cho_solve(rest, K[count:, :count], check_finite=False)
            reduced = K[:count, :count] - K[:count, count:] @ across
            p, _, solved = nonnegative_qp(
                np.ascontiguousarray(reduced),
                across.T @ f[count:] - f[:count],
                np.ones(count, bool),
            )
            converged = converged and solved
            x[:] = 0.0
            x[active] = np.concatenate(
                [p, cho_solve(rest, f[count:], check_finite=False) - across @ p]
            )
            if (p > 0.0).all() or not solved:
                break
            touching = x[:s] > 0.0
        return x, converged

    def _max_evidence_weight(self) -> float:
        """Λ/λ of maximal evidence, with p and g unconstrained on the whole support."""
        K, f = self._data + self._prior, self._linear
        shear = np.isin(np.arange(len(f)), self._shear)
        rest = cho_factor(K[~shear][:, ~shear], lower=True, check_finite=False)
        across = cho_solve(rest, K[~shear][:, shear], check_finite=False)
        reduced = K[shear][:, shear] - K[shear][:, ~shear] @ across
        gradient = f[shear] - across.T @ f[~shear]
        values, vectors = eigh(reduced, self._shear_smoothness, check_finite=False)
        values, squares = np.maximum(values, 0.0), (vectors.T @ gradient) ** 2
        total = values + (10.0**_DECADES)[:, None]
        cost = np.log(total).sum(axis=1) - len(values) * np.log(10.0) * _DECADES  # −2 ln evidence
        cost -= (squares / total).sum(axis=1)
        return float(10.0 ** _minimum(_DECADES, cost))


def _minimum(x: np.ndarray, y: np.ndarray) -> float:
    """Minimum of a function sampled on an even grid, by a parabola through the lowest samples."""
    k = int(np.clip(np.argmin(y), 1, len(x) - 2))
    before, least, after = y[k - 1 : k + 2]
    curvature = before - 2.0 * least + after
    shift = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
    return float(x[k] + np.clip(shift, -1.0, 1.0) * (x[1] - x[0]))
