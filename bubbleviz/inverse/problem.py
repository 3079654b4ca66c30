"""The inverse problem of Eq. 23 in dimensionless form, regularised on purpose.

    min  ½ uᵀQu − gᵀu + ½ λ p_cᵀ L p_c + τᵀ p_c
    s.t. L u = A∘(p_v − p_c),   p_v = −βᵀu or measured,   p_c ≥ 0

Lengths are in units of a, pressures in γ0/a; the first two terms are half the squared misfit in
units of the noise, so λ and τ are those of a posterior density.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.stiffness import cotangent_laplacian

DENSE_LIMIT = 3_000
"""Nodes up to which n² numbers are kept: L⁻¹ and the Hessian of Eq. 24, formed once."""

_FEW = 50
"""Rows of L⁻¹ that are read in the time of a solve with the factors of L."""


@dataclass(frozen=True)
class Scales:
    """Length a and pressure γ0/a: u/a, p a/γ0 and A/a² are dimensionless.

    Attributes
    ----------
    length_m : float
        Radius of the disc with the membrane's area.
    pressure_pa : float
        Pressure that deflects the membrane by about its own size.
    """

    length_m: float
    pressure_pa: float

    @classmethod
    def of(cls, mesh: MembraneMesh, tension_n_per_m: float) -> Scales:
        """Scales of a membrane with tension γ0."""
        length = float(np.sqrt(mesh.facet_areas.sum() / np.pi))
        return cls(length, tension_n_per_m / length)


class Equilibrium:
    """Static equilibrium of membrane and gas on the free nodes (Eqs. 5 and 22), dimensionless.

    Parameters
    ----------
    mesh : MembraneMesh
    gas : Gas
    scales : Scales

    Attributes
    ----------
    L : (n, n) sparse array
        Stiffness of the free nodes.
    A : (n,) array
        Nodal areas.
    beta : (n,) array
        Gas stiffness: p_v = −βᵀu.
    """

    def __init__(self, mesh: MembraneMesh, gas: Gas, scales: Scales) -> None:
        free = mesh.free
        self.L = cotangent_laplacian(mesh)[free][:, free].tocsc()
        self.A = mesh.areas[free] / scales.length_m**2
        self.beta = gas.beta[free] * scales.length_m / scales.pressure_pa
        # SuperLU's symmetric mode: half the fill of its default for a positive definite matrix.
        factor = splu(self.L, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        # L is symmetric, and SuperLU's transposed solve is the faster one.
        self._solve = partial(factor.solve, trans="T")
        self.bulge = self._solve(self.A)
        """Displacement under unit pressure, L⁻¹A, (n,)."""
        self._gas_stiffness = 1.0 + self.beta @ self.bulge

    @cached_property
    def inverse(self) -> np.ndarray | None:
        """L⁻¹, (n, n), with its rows together in memory; None beyond `DENSE_LIMIT`."""
        n = len(self.A)
        return self._solve(np.eye(n)).T if n <= DENSE_LIMIT else None

    def displacement(
        self, pressure: np.ndarray, measured_gas: float | None = None
    ) -> tuple[np.ndarray, float]:
        """Displacement u and p_v under contact pressure p_c (Eq. 24: u = −M p_c)."""
        nodes, load = np.flatnonzero(pressure), self.A * pressure
        rows = self._rows(nodes)
        u = -(load[nodes] @ rows) if rows is not None else -self._solve(load)
        gas = measured_gas
        if gas is None:
            gas = -float(self.beta @ u) / self._gas_stiffness
        return u + gas * self.bulge, gas

    def adjoint(
        self, force: np.ndarray, gas_measured: bool, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Mᵀ force: what a unit of p_c at each node, or at some, does against `force` (n,)."""
        if not gas_measured:
            force = force - self.beta * (force @ self.bulge) / self._gas_stiffness
        if nodes is None:
            return self.A * self._solve(force)
        rows = self._rows(nodes)
        pulled = rows @ force if rows is not None else self._solve(force)[nodes]
        return self.A[nodes] * pulled

    def gradient(
        self, problem: FrameProblem, pressure: np.ndarray, nodes: np.ndarray | None = None
    ) -> np.ndarray:
        """Gradient of the objective with respect to p_c alone, (n,) (Eq. 24).

        Where `nodes` (k,) are given, it is 0 at the others, and found sooner.
        """
        known = problem.measured_gas is not None
        # Under p_c alone, u = −M p_c whatever p_v was measured.
        change, _ = self.displacement(pressure, 0.0 if known else None)
        some = slice(None) if nodes is None else nodes
        gradient = np.zeros_like(pressure)
        smoothing = (problem.lambda_ * (self.L @ pressure))[some]
        data = self.adjoint(problem.Q @ change, known, nodes)
        gradient[some] = problem.at_zero[some] - data + smoothing + problem.tau[some]
        return gradient

    def _rows(self, nodes: np.ndarray) -> np.ndarray | None:
        """Rows (k, n) of L⁻¹ for a few nodes; None where solving is faster."""
        if len(nodes) > _FEW or self.inverse is None:
            return None
        return self.inverse.take(nodes, axis=0)

    def gradient_at_zero(
        self, Q: sparse.csr_array, g: np.ndarray, measured_gas: float | None
    ) -> np.ndarray:
        """Gradient of the misfit with respect to p_c at p_c = 0, (n,)."""
        if measured_gas is not None:
            g = g - Q @ (measured_gas * self.bulge)
        return self.adjoint(g, measured_gas is not None)

    def response(self, nodes: np.ndarray, gas_measured: bool = False) -> np.ndarray:
        """Columns (n, k) of M in Eq. 24, u = −M p_c, of some nodes (k,)."""
        if self.inverse is not None:  # symmetric: its rows are its columns
            M = (self.A[nodes, None] * self.inverse[nodes]).T
        else:
            unit = np.zeros((len(self.A), len(nodes)))
            unit[nodes, np.arange(len(nodes))] = self.A[nodes]
            M = self._solve(unit)
        if not gas_measured:
            M -= np.outer(self.bulge, self.gas_response(M))
        return M

    def gas_response(self, M: np.ndarray) -> np.ndarray:
        """p_v that the gas law answers to each column of −M (n, k), (k,)."""
        return (self.beta @ M) / self._gas_stiffness


@dataclass(frozen=True)
class FrameProblem:
    """The numbers of one frame.

    Attributes
    ----------
    Q : (n, n) sparse array
    g : (n,) array
    lambda_ : float
        Weight of the H1 term.
    tau : (n,) array
        Weights of the L1 term, proportional to A.
    at_zero : (n,) array
        Gradient of the misfit with respect to p_c at p_c = 0.
    allowed : (n,) bool array
        Nodes that may carry contact pressure; p_c = 0 at the others.
    measured_gas : float or None
        p_v where it was measured.
    """

    Q: sparse.csr_array
    g: np.ndarray
    lambda_: float
    tau: np.ndarray
    at_zero: np.ndarray
    allowed: np.ndarray
    measured_gas: float | None = None

    @cached_property
    def weight(self) -> float:
        """Trace of Q: how much the pixels of this frame say in all."""
        return float(self.Q.diagonal().sum())

    def debiased(self, support: np.ndarray) -> FrameProblem:
        """The same problem without the L1 term, on a support (n,) bool."""
        return replace(self, tau=np.zeros_like(self.tau), allowed=support)

    def gradient_scale(self, areas: np.ndarray) -> float:
        """Largest gradient per area at p_c = 0 on the allowed nodes: the unit of KKT residuals."""
        gradient = (self.at_zero + self.tau) / areas
        return float(np.max(np.abs(gradient[self.allowed]), initial=0.0))


@dataclass(frozen=True)
class Pressure:
    """A contact pressure that solves a `FrameProblem`, dimensionless.

    Attributes
    ----------
    values : (n,) array
    iterations : int
        Iterations or pivots it took.
    converged : bool
    gradient : (n,) array or None
        Gradient of the problem there without its L1 term, where the solver has one at hand.
    """

    values: np.ndarray
    iterations: int
    converged: bool
    gradient: np.ndarray | None = None


def natural_residual(
    areas: np.ndarray, problem: FrameProblem, pressure: np.ndarray, gradient: np.ndarray
) -> float:
    """Relative KKT residual ‖min(p_c, ∇)‖∞ of the reduced problem (Eq. 24) on the allowed nodes.

    p_c is in units of its own maximum and the gradient per area in units of its maximum at
    p_c = 0, so that the certificate depends neither on mesh nor on units nor on the solver.
    """
    scale = problem.gradient_scale(areas)
    if scale == 0.0:
        return 0.0
    allowed = problem.allowed
    slope = gradient[allowed] / areas[allowed] / scale
    top = float(np.max(pressure, initial=0.0))
    share = pressure[allowed] / top if top > 0.0 else np.zeros(len(slope))
    return float(np.max(np.abs(np.minimum(share, slope)), initial=0.0))
