"""The inverse problem of Eq. 23 in dimensionless form, regularised on purpose.

    min  ½ uᵀQu − gᵀu + ½ λ p_cᵀ L p_c + τᵀ p_c
    s.t. L u = A∘(p_v − p_c),   p_v = −βᵀu or measured,   p_c ≥ 0

Lengths are in units of a, pressures in γ0/a; the first two terms are half the squared misfit in
units of the noise, so λ and τ are those of a posterior density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from bubbleviz.inverse.scales import Scales
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.stiffness import cotangent_laplacian


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
        self._solve = splu(self.L).solve
        self.bulge = self._solve(self.A)
        """Displacement under unit pressure, L⁻¹A, (n,)."""
        self._gas_stiffness = 1.0 + self.beta @ self.bulge

    def displacement(
        self, pressure: np.ndarray, measured_gas: float | None = None
    ) -> tuple[np.ndarray, float]:
        """Displacement u and p_v under contact pressure p_c (Eq. 24: u = −M p_c)."""
        u = -self._solve(self.A * pressure)
        gas = measured_gas
        if gas is None:
            gas = -float(self.beta @ u) / self._gas_stiffness
        return u + gas * self.bulge, gas

    def adjoint(self, force: np.ndarray, gas_measured: bool) -> np.ndarray:
        """Mᵀ force: what a unit of p_c at each node does against `force` (n,)."""
        x = self._solve(force)
        if not gas_measured:
            x -= self._solve(self.beta) * (force @ self.bulge) / self._gas_stiffness
        return self.A * x


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
    measured_gas : float or None
        p_v where it was measured.
    """

    Q: sparse.csr_array
    g: np.ndarray
    lambda_: float
    tau: np.ndarray
    measured_gas: float | None = None


@dataclass(frozen=True)
class Solution:
    """Dimensionless solution of a `FrameProblem`."""

    displacement: np.ndarray
    pressure: np.ndarray
    gas: float
    iterations: int
    converged: bool


def kkt_residual(equilibrium: Equilibrium, problem: FrameProblem, pressure: np.ndarray) -> float:
    """Relative KKT residual of a contact pressure, whichever solver it came from.

    The natural residual ‖min(p_c, ∇)‖∞ of the reduced problem (Eq. 24), with p_c in units of its
    own maximum and the gradient in units of its maximum at p_c = 0.
    """
    measured = problem.measured_gas
    u, _ = equilibrium.displacement(pressure, measured)
    u0, _ = equilibrium.displacement(np.zeros_like(pressure), measured)
    known = measured is not None
    gradient = _gradient(equilibrium, problem, u, pressure, known)
    at_zero = _gradient(equilibrium, problem, u0, np.zeros_like(pressure), known)
    # Per area, so that the certificate does not depend on the mesh.
    scale = np.max(np.abs(at_zero / equilibrium.A))
    top = np.max(pressure)
    if top <= 0.0 or scale <= 0.0:
        return float(max(0.0, -np.min(gradient / equilibrium.A)) / max(scale, 1e-300))
    natural = np.minimum(pressure / top, gradient / equilibrium.A / scale)
    return float(np.max(np.abs(natural)))


def _gradient(
    equilibrium: Equilibrium,
    problem: FrameProblem,
    u: np.ndarray,
    pressure: np.ndarray,
    gas_measured: bool,
) -> np.ndarray:
    data = -equilibrium.adjoint(problem.Q @ u - problem.g, gas_measured)
    return data + problem.lambda_ * (equilibrium.L @ pressure) + problem.tau
