"""The contact traction that explains ranges and flow, around a shape of the exact membrane.

    min  ½ ‖e − D (δ − S a Δp + S t Δq + b g)‖²_W + ½ λ pᵀ L p + ½ Λ qᵀ L q + ½ (g/σ_g)²

over the pressure p ≥ 0, the tangential traction q and the error g of a measured gas pressure, on
the support of a contact. How smooth q is, Λ, is the likeliest by the evidence (MacKay 1992):
friction may leave a contact without shear, or put most of it at its edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve, eigh

from bubbleviz.inverse import nonnegative_qp, part

# Coulomb's bound on the tangential traction, as a cone programme.


_NOTHING = 1e-4
"""Share of the largest p below which an interior point has come to 0, as it never does."""


def within_cone(
    H: np.ndarray,  # (c, c)
    linear: np.ndarray,  # (c,), b
    nodes: int,  # s: x is p (s,), q (2s,) and what is not bounded
    friction: float,  # μ
) -> tuple[np.ndarray, bool]:
    """Minimise ½ xᵀHx − bᵀx with |q| ≤ μ p at every node; and whether that was solved."""
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
    free = x[:nodes] <= _NOTHING * x[:nodes].max()
    x[: 3 * nodes][np.concatenate([free, np.repeat(free, 2)])] = 0.0
    return x, result.status == clarabel.SolverStatus.Solved


_DECADES = np.linspace(-8.0, 8.0, 129)
"""log₁₀ of Λ/λ: from the roughest tangential traction that is compared to the smoothest."""


@dataclass(frozen=True)
class Unknowns:
    """What contact and gas may add at a support of s nodes."""

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
    active: np.ndarray  # (c,) int, of p, q and g one after the other, those that are free
    columns: np.ndarray  # (3n, c), motions under unit p, q and g
    measurements: Measurements  # that were explained
    seen: np.ndarray  # (k, c), the columns in the measurements, in standard deviations
    converged: bool

    def answer(self, motions: np.ndarray) -> np.ndarray:
        """Changes of the `active` unknowns that hide motions (3n, k) which nothing caused."""
        measured = self.measurements
        seen = np.sqrt(measured.weight)[:, None] * (measured.jacobian @ motions)
        pull = (self.seen.T @ seen)[self.active]
        change: np.ndarray = cho_solve(self.factor, pull, check_finite=False)
        return change


class TractionProblem:
    """The problem of one frame around one shape."""

    def __init__(
        self,
        # (3n, c), motions under unit p, q and, where it is measured, gas pressure, in this order
        columns: np.ndarray,
        relaxing: np.ndarray,  # (n, 3), δ: motion to equilibrium under the present traction, m
        measurements: Measurements,
        smoothness: np.ndarray,  # (s, s), λ L on the support, 1/Pa²
        present: Unknowns,
        gas_sigma_pa: float | None,  # None where the gas pressure follows from the volume
    ) -> None:
        self._columns, self._relaxing, self._smoothness = columns, relaxing, smoothness
        self._size, self._measurements = len(smoothness), measurements
        m = measurements
        left = m.error - m.jacobian @ relaxing.ravel()
        J = m.jacobian @ columns
        self._linear = J.T @ (m.weight * left)
        J *= np.sqrt(m.weight)[:, None]
        self._seen, self._data = J, J.T @ J
        gas = [] if gas_sigma_pa is None else [present.gas_error_pa]
        self._before = np.concatenate([present.pressure, present.shear, gas])
        self._linear += self._data @ self._before
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
        """Likeliest traction."""
        s = self._size
        weight = self._likeliest_weight()
        H = self._data + self._prior
        H[np.ix_(self._shear, self._shear)] += weight * self._shear_smoothness
        if friction is not None:
            x, converged = within_cone(H, self._linear, s, friction)
        else:
            x, converged = self._pressing(H)
        active = self._active(x[:s] > 0.0)
        factor = cho_factor(part(H, active), lower=True, check_finite=False)
        motion = (self._columns @ (x - self._before)).reshape(-1, 3) + self._relaxing
        gas = float(x[-1]) if len(x) > 3 * s else 0.0
        return SolvedTraction(
            Unknowns(x[:s], x[s : 3 * s], gas),
            motion,
            factor,
            active,
            self._columns,
            self._measurements,
            self._seen,
            converged,
        )

    def _active(self, touching: np.ndarray) -> np.ndarray:
        gas = np.ones(len(self._before) - 3 * self._size, bool)
        return np.flatnonzero(np.concatenate([touching, np.repeat(touching, 2), gas]))

    def _pressing(self, H: np.ndarray) -> tuple[np.ndarray, bool]:
        """Minimise with p ≥ 0, and no traction at all where p is 0."""
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

    def _likeliest_weight(self) -> float:
        """Λ/λ of the largest evidence, with p and g free on the whole support."""
        K, f = self._data + self._prior, self._linear
        shear = np.isin(np.arange(len(f)), self._shear)
        rest = cho_factor(K[~shear][:, ~shear], lower=True, check_finite=False)
        across = cho_solve(rest, K[~shear][:, shear], check_finite=False)
        reduced = K[shear][:, shear] - K[shear][:, ~shear] @ across
        pull = f[shear] - across.T @ f[~shear]
        values, vectors = eigh(reduced, self._shear_smoothness, check_finite=False)
        values, squares = np.maximum(values, 0.0), (vectors.T @ pull) ** 2
        total = values + (10.0**_DECADES)[:, None]
        unlikely = np.log(total).sum(axis=1) - len(values) * np.log(10.0) * _DECADES
        unlikely -= (squares / total).sum(axis=1)
        return float(10.0 ** _lowest(_DECADES, unlikely))


def _lowest(x: np.ndarray, y: np.ndarray) -> float:
    """Where a function that is known on an even grid is lowest, by the parabola there."""
    k = int(np.clip(np.argmin(y), 1, len(x) - 2))
    before, least, after = y[k - 1 : k + 2]
    bend = before - 2.0 * least + after
    shift = 0.5 * (before - after) / bend if bend > 0.0 else 0.0
    return float(x[k] + np.clip(shift, -1.0, 1.0) * (x[1] - x[0]))
