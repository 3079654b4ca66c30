"""The inverse problem of Eq. 23 in dimensionless form, regularised on purpose.

    min  ½ uᵀQu − gᵀu + ½ λ p_cᵀ L p_c + τᵀ p_c
    s.t. L u = A∘(p_v − p_c),   p_v = −βᵀu or measured,   p_c ≥ 0

Lengths are in units of a, pressures in γ0/a; the first two terms are half the squared misfit in
units of the noise, so λ and τ are those of a posterior density.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from bubbleviz.camera import Linearisation, Observation
from bubbleviz.membrane import Gas, MembraneMesh, cotangent_laplacian, symmetric_lu

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


# Equilibrium of the linear membrane under given contact and gas pressures (Eq. 5).
#
# It offers what `RubberEquilibrium` and `LinearisedRubber` do, for motion along the normals alone.


class LinearEquilibrium:
    """γ0 L u = A (p_v − p_c) on the free nodes of a mesh; those of its rim stay where they are.

    Parameters
    ----------
    mesh : MembraneMesh
    tension_n_per_m : float
        γ0.
    """

    def __init__(self, mesh: MembraneMesh, tension_n_per_m: float) -> None:
        self._mesh, self._stiffness = mesh, tension_n_per_m * cotangent_laplacian(mesh)
        self._factor = symmetric_lu(self._stiffness[mesh.free][:, mesh.free].tocsc())

    def residual(self, x: np.ndarray, pressure: np.ndarray, gas: float) -> np.ndarray:
        """What the forces at the nodes lack of equilibrium, (n, 3), N.

        Parameters
        ----------
        x : (n, 3) array
            Shape, m.
        pressure : (n,) array
            p_c, Pa.
        gas : float
            p_v, Pa.
        """
        mesh = self._mesh
        u = np.einsum("ij,ij->i", x - mesh.nodes, mesh.normals)
        left: np.ndarray = self._stiffness @ u - mesh.areas * (gas - pressure)
        return left[:, None] * mesh.normals

    def linearised(self, x: np.ndarray, pressure: np.ndarray, gas: float) -> LinearResponse:
        """How it moves at a shape; the same at all of them."""
        return LinearResponse(self._mesh, self._factor, x)


class LinearResponse:
    """Motion of a linear membrane under forces.

    Parameters
    ----------
    mesh : MembraneMesh
    factor : SuperLU
        Of γ0 L on the free nodes.
    x : (n, 3) array
        Shape that it was asked for at, m.
    """

    def __init__(self, mesh: MembraneMesh, factor: SuperLU, x: np.ndarray) -> None:
        self._mesh, self._factor, self.x = mesh, factor, x

    def motion(self, force: np.ndarray) -> np.ndarray:
        """Motion (n, 3) under forces (n, 3) in N, m."""
        moved = self._moved(np.einsum("ij,ij->i", force, self._mesh.normals))
        return moved[:, None] * self._mesh.normals

    def pull(self, force: np.ndarray) -> np.ndarray:
        """What unit contact pressures do against forces (n, 3), (n,)."""
        return self._mesh.areas * self._moved(np.einsum("ij,ij->i", force, self._mesh.normals))

    def responses(self, nodes: np.ndarray) -> np.ndarray:
        """Motion under unit pressures from inside at nodes (c,), (3n, c), m/Pa."""
        load = np.zeros((len(self._mesh.nodes), len(nodes)))
        load[nodes, np.arange(len(nodes))] = self._mesh.areas[nodes]
        moved = self._moved(load)
        return (self._mesh.normals[:, :, None] * moved[:, None]).reshape(-1, len(nodes))

    def _moved(self, load: np.ndarray) -> np.ndarray:
        """Displacement along the normals under loads (n, …) along them, of the same shape."""
        moved, free = np.zeros_like(load), self._mesh.free
        moved[free] = self._factor.solve(load[free])
        return moved


# Normal equations of the range residuals: Q = DᵀWD and Dᵀ W (d̃ − d0) (Eq. 21).
#
# The paper's f = 2Dᵀd0 should read 2Dᵀ(d0 − d̃). A ray touches the three nodes of one triangle, so
# Q has the pattern of the stiffness matrix whatever the shape, and only its values ever change.


_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
"""Corners of a triangle in the order of `Linearisation.products`."""


class NormalEquations:
    """Assembles Q and its right-hand side on the free nodes of a mesh.

    Parameters
    ----------
    mesh : MembraneMesh
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        self._free, self._nodes, n = mesh.free, len(mesh.nodes), len(mesh.free)
        number = np.full(self._nodes, -1)
        number[self._free] = np.arange(n)
        ends = number[mesh.triangles][:, _PAIRS]  # (m, 6, 2)
        low, high = ends.min(axis=2), ends.max(axis=2)
        pairs, places = np.unique(np.where(low < 0, n * n, low * n + high), return_inverse=True)
        self._places = places.reshape(-1, len(_PAIRS))
        """Where each pair of corners of each triangle goes among the pairs of nodes, (m, 6)."""
        pairs = pairs[pairs < n * n]  # the others, last, have an end on the rim
        self._pairs = len(pairs)
        row, column = np.divmod(pairs, n)
        numbered = sparse.coo_array((np.arange(1.0, len(pairs) + 1.0), (row, column)), shape=(n, n))
        self._pattern = (numbered + sparse.triu(numbered, 1).T).tocsr()
        self._pair_of_entry = self._pattern.data.astype(int) - 1

    def assemble(
        self, observation: Observation, linear: Linearisation
    ) -> tuple[sparse.csr_array, np.ndarray]:
        """Q (n_free×n_free, 1/m²) and Dᵀ W e (n_free, 1/m) of one frame.

        Returns
        -------
        Q : sparse array
            Always with the same pattern.
        g : (n_free,) array
        """
        hits = linear.hits
        weight = observation.weight[hits.ray]
        products = weight[:, None] * linear.products
        places = self._places[hits.triangle].ravel()
        sums = np.bincount(places, products.ravel(), minlength=self._pairs)
        Q = copy(self._pattern)  # SciPy's own constructor checks indices that never change
        Q.data = sums[self._pair_of_entry]
        pull = weight * (observation.residual_m[hits.ray] - linear.offset_m)
        pulls = pull[:, None] * hits.sensitivity
        g = np.bincount(linear.nodes.ravel(), pulls.ravel(), minlength=self._nodes)
        return Q, g[self._free]
