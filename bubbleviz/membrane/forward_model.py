"""The forward problem: a rigid object at a pose pressed into the membrane (Eqs. 10 to 16)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.membrane.gap import GapFinder
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.obstacle import Obstacle, ObstacleSolver
from bubbleviz.membrane.stiffness import cotangent_laplacian
from bubbleviz.rigid_object import RigidObject

Outer = Literal["joint", "bracket"]


@dataclass(frozen=True)
class Contact:
    """Equilibrium of the membrane pressed by a rigid object, and how well it holds."""

    displacement_m: np.ndarray  # (n,), u along the reference normals, m; 0 on the rim
    displacement_3d_m: np.ndarray  # (n, 3), the whole displacement, m
    contact_pressure_pa: np.ndarray  # (n,), p_c ≥ 0, Pa
    nodal_force_n: np.ndarray  # (n, 3), of the object on the membrane, N
    # (n,), bound g on u from the object, m; inf where its normal line does not meet it
    gap_m: np.ndarray
    gas_pressure_change_pa: float  # p_v, Pa
    complementarity: float  # max |φ p_c| with φ = g − u, Pa·m (Eq. 13)
    penetration_m: float  # max(u − g, 0) over the free nodes, m
    # the same on the clamped rim, which cannot give way; above 0 the object sits on it
    rim_penetration_m: float
    # max |K u − A p_v + A∘p_c| relative to the largest of its terms (Eq. 5)
    balance_residual: float
    gas_law_residual: float  # |P(V(u)) − P0 − p_v| / P0
    iterations: int  # sparse factorisations
    outer_iterations: int  # gas-law iterations; 1 where it is solved together with the contact
    converged: bool  # contact and gas law both hold


class ForwardModel:
    """Presses rigid objects into one membrane.

    Parameters
    ----------
    mesh : MembraneMesh
    tension_n_per_m : float
        γ0.
    gas : Gas
    outer : {"joint", "bracket"}
        How the gas law is met. `joint`: solved exactly in every step of the contact solver,
        with `bracket` behind it. `bracket`: a root of P(V(u(p_v))) − P0 − p_v, which falls
        monotonically, between bounds that always hold it. (The paper's fixed point
        p ← p + ω (P(V) − P0 − p) diverges where the gas is stiff; dropped in 0.3.)
    """

    def __init__(
        self,
        mesh: MembraneMesh,
        tension_n_per_m: float,
        gas: Gas,
        *,
        outer: Outer = "joint",
    ) -> None:
        if not (np.isfinite(tension_n_per_m) and tension_n_per_m > 0.0):
            raise InputError(f"tension {tension_n_per_m} N/m: give a number above 0")
        self.mesh, self.tension, self.gas = mesh, tension_n_per_m, gas
        if outer not in ("joint", "bracket"):
            raise InputError(f"outer={outer!r}: use joint; relaxed is gone since 0.3")
        self.outer = outer
        self._finder = GapFinder(mesh)
        self._laplacian = cotangent_laplacian(mesh)
        free = mesh.free
        self._solver = ObstacleSolver(
            self._laplacian[free][:, free], mesh.areas[free], gas.dV_du[free]
        )
        self._active: np.ndarray | None = None

    def press(self, obj: RigidObject, T_B_O: np.ndarray) -> Contact:
        """Equilibrium with the object at the pose; the contact of the last call starts it."""
        return self.solve(self._finder.gaps(obj, T_B_O))

    def forget(self) -> None:
        """Start the next call as if it were the first."""
        self._active = None

    def solve(self, gap_m: np.ndarray) -> Contact:
        """Equilibrium under given bounds g (n,) on the displacement, m."""
        bound = gap_m[self.mesh.free]
        if self.outer == "bracket":
            state, factorisations, outers, ok = self._bracketed(bound)
        else:
            state = self._solver.solve(bound, self._gas_rule, self._active)
            factorisations, outers, ok = state.iterations, 1, state.converged
            if not ok:
                state, more, outers, ok = self._bracketed(bound)
                factorisations += more
        self._active = state.active if ok else None
        return self._certified(state, gap_m, factorisations, outers, ok)

    def _gas_rule(self, volume: float, slope: float) -> float:
        """Pressure over γ0 at which gas law and membrane agree: the upper root of a quadratic.

        With V = Vc + s p_v the gas law (P0 + p_v)(Vc + s p_v) = P0 V0 has one root with V > 0.
        """
        P0, V0 = self.gas.P0, self.gas.V0
        s, Vc = slope / self.tension, V0 + volume
        if s <= 0.0:
            return (P0 * (V0 - Vc) / Vc if Vc > 0.0 else np.inf) / self.tension
        q = Vc + s * P0
        root = np.hypot(Vc - s * P0, 2.0 * np.sqrt(s * P0 * V0))
        # Two forms of one root: whichever does not cancel.
        change = 2.0 * P0 * (V0 - Vc) / (q + root) if q > 0.0 else (root - q) / (2.0 * s)
        return change / self.tension

    def _at_pressure(self, bound: np.ndarray, pressure_pa: float) -> Obstacle:
        fixed = pressure_pa / self.tension
        state = self._solver.solve(bound, lambda *_: fixed, self._active, max_iterations=2_000)
        self._active = state.active
        return state

    def _volume(self, state: Obstacle) -> float:
        u = np.zeros(len(self.mesh.nodes))
        u[self.mesh.free] = state.displacement
        return self.gas.volume(u)

    def _bracketed(self, bound: np.ndarray) -> tuple[Obstacle, int, int, bool]:
        """Root of P0 V0 − (P0 + p_v) V(u(p_v)), by Brent's method between bounds that hold it.

        V grows with p_v, so the sign changes once, above −P0; where no gas volume is left the
        sign is that of a pressure too low, and the function stays finite.
        """
        from scipy.optimize import brentq  # 0.2 s; estimates do not need it

        P0, V0 = self.gas.P0, self.gas.V0
        states: list[Obstacle] = []

        def excess(pressure_pa: float) -> float:
            states.append(self._at_pressure(bound, pressure_pa))
            return P0 * V0 - (P0 + pressure_pa) * self._volume(states[-1])

        low, high = -P0, 1e-2 * P0
        while excess(high) > 0.0:
            low, high = high, 4.0 * high
        root = brentq(excess, low, high, xtol=1e-13 * P0, rtol=1e-14, maxiter=200)
        states.append(self._at_pressure(bound, root))
        iterations = sum(s.iterations for s in states)
        return states[-1], iterations, len(states), states[-1].converged

    def _certified(
        self, state: Obstacle, gap_m: np.ndarray, factorisations: int, outers: int, ok: bool
    ) -> Contact:
        """Full-size fields and residuals, computed afresh from them."""
        mesh, free = self.mesh, self.mesh.free
        u = np.zeros(len(mesh.nodes))
        u[free] = state.displacement
        p_c = np.zeros_like(u)
        p_c[free] = np.maximum(state.reaction, 0.0) * self.tension / mesh.areas[free]
        p_v = state.pressure * self.tension
        elastic = self.tension * (self._laplacian @ u)[free]
        gas, contact = mesh.areas[free] * p_v, (mesh.areas * p_c)[free]
        largest = max(float(np.abs(x).max()) for x in (elastic, gas, contact))
        over = u - gap_m
        met = np.isfinite(gap_m)
        return Contact(
            displacement_m=u,
            displacement_3d_m=u[:, None] * mesh.normals,
            contact_pressure_pa=p_c,
            nodal_force_n=-(mesh.areas * p_c)[:, None] * mesh.normals,
            gap_m=gap_m,
            gas_pressure_change_pa=p_v,
            complementarity=float(np.abs(over[met] * p_c[met]).max(initial=0.0)),
            penetration_m=float(over[free].max(initial=0.0)),
            rim_penetration_m=float(over[mesh.rim].max(initial=0.0)),
            balance_residual=float(np.abs(elastic - gas + contact).max()) / max(largest, 1e-300),
            gas_law_residual=abs(self.gas.pressure_change(u) - p_v) / self.gas.P0,
            iterations=factorisations,
            outer_iterations=outers,
            converged=ok and bool(np.isfinite(u).all()),
        )
