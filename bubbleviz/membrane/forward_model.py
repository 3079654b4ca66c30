"""The forward problem: a rigid object at a pose pressed into the membrane (Eqs. 10 to 16)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from bubbleviz.errors import InputError
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh, cotangent_laplacian
from bubbleviz.membrane.object_surface import ObjectSurface
from bubbleviz.membrane.sparse_factor import symmetric_lu
from bubbleviz.membrane.triangle_scene import TriangleScene
from bubbleviz.rigid_object import RigidObject

# Gap between each node and a rigid object along its normal (Eqs. 10 to 12).


class GapFinder:
    """Intersects the normal lines of a membrane with rigid objects.

    The object presses from outside, so the membrane stays inside of it: node k may move along its
    normal up to the lowest point where the line enters the object, above the node (a gap) or below
    it (a penetration, which Eq. 16 removes). Points more than half way to the opposite side of the
    dome, or of the rim's cylinder below it, belong to the nodes there; points deeper than a rim
    radius behind the rim belong to none. Both are ignored, unless the node itself is inside that
    part of the object. If an object is not watertight, every intersection counts as an entry.
    """

    def __init__(self, mesh: MembraneMesh) -> None:
        self.mesh = mesh
        self._surface: ObjectSurface | None = None

    def gaps(self, obj: RigidObject, T_B_O: np.ndarray) -> np.ndarray:
        """Upper bound g of the displacement, shape (n,), m; inf without intersection."""
        if self._surface is None or obj is not self._surface.obj:
            self._surface = ObjectSurface(obj)
        nodes = (self.mesh.nodes - T_B_O[:3, 3]) @ T_B_O[:3, :3]
        ray, where, entering = self._surface.crossings(nodes, self.mesh.normals @ T_B_O[:3, :3])
        return self._lowest_entry(ray, where, entering | (not self._surface.solid))

    def _lowest_entry(self, ray: np.ndarray, where: np.ndarray, counts: np.ndarray) -> np.ndarray:
        n = len(self.mesh.nodes)
        lowest = np.full(n, np.inf)
        # The node is inside the object if the highest crossing below it is an entry.
        below = counts & (where <= 0.0)
        last = np.full(n, -np.inf)
        np.maximum.at(last, ray[where <= 0.0], where[where <= 0.0])
        own = below & (where == last[ray])
        valid = counts & ((where >= -self.reach[ray]) | own)
        np.minimum.at(lowest, ray[valid], where[valid])
        return lowest

    @cached_property
    def reach(self) -> np.ndarray:
        """Distance inward along each normal within which points belong to the node, (n,), m."""
        mesh = self.mesh
        step = 1e-3 * np.sqrt(mesh.facet_areas.sum())  # to miss the node's own triangles
        rays = np.hstack([mesh.nodes - step * mesh.normals, -mesh.normals])
        across = 0.5 * (TriangleScene(mesh.nodes, mesh.triangles).cast(rays).distance + step)
        return np.minimum(across, _chamber_depth(mesh))


def _chamber_depth(mesh: MembraneMesh) -> np.ndarray:
    """Distance inward to half through the rim's cylinder, or to one rim radius behind the rim."""
    radius = float(np.hypot(*mesh.nodes[mesh.rim, :2].T).max())
    x, n = mesh.nodes[:, :2], mesh.normals[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        down = (mesh.nodes[:, 2] + radius) / mesh.normals[:, 2]
        a, b = np.einsum("ij,ij->i", n, n), np.einsum("ij,ij->i", x, n)
        root = np.sqrt(b**2 - a * (np.einsum("ij,ij->i", x, x) - radius**2))
        side = 0.5 * (b + root) / a  # NaN where the line never enters the cylinder
    down[~(down > 0.0)] = np.inf
    return np.fmin(down, np.where(side > 0.0, side, np.inf))


# The obstacle problem: a membrane under pressure with an upper bound (Eqs. 15 and 16).


PressureRule = Callable[[float, float], float]
"""p = rule(v, s): pressure (over γ0) at which u = u_p p + u_g has volume change v + s p."""


@dataclass(frozen=True)
class Obstacle:
    """Solution of L u = A p − λ, u ≤ g, λ ≥ 0, λ (g − u) = 0 on the free nodes."""

    displacement: np.ndarray  # (f,), u, m
    reaction: np.ndarray  # (f,), λ = A p_c / γ0, m
    pressure: float  # p = p_v / γ0, 1/m
    active: np.ndarray  # (f,) bool, nodes in contact
    iterations: int  # sparse factorisations
    converged: bool


class ObstacleSolver:
    """Primal–dual active set (semi-smooth Newton) on the free nodes of one mesh.

    Every step fixes u = g on the active nodes, solves for the others, removes active nodes with a
    tensile reaction and adds nodes that penetrate. On a mesh whose Laplacian is an M-matrix
    (Delaunay) this decreases monotonically and terminates; if the number of wrong nodes stops
    decreasing (slivers), only the last wrong node is changed (Júdice and Pires), which terminates
    for any positive definite matrix.
    """

    def __init__(
        self,
        laplacian: sparse.csr_array,  # (f, f) sparse, cotangent Laplacian of the free nodes
        areas: np.ndarray,  # (f,), nodal areas, m²
        # (f,), volume change per displacement, m²
        volume_gradient: np.ndarray,
    ) -> None:
        order = np.argsort(symmetric_lu(laplacian.tocsc()).perm_c)
        self._order = order  # fill-reducing once; its restriction to a subset is nearly as good
        self._laplacian = laplacian[order][:, order].tocsr()
        self._areas, self._gradient = areas[order], volume_gradient[order]
        self._diagonal = self._laplacian.diagonal()

    def solve(
        self,
        bound: np.ndarray,  # (f,), g, m; inf where there is no object
        rule: PressureRule,  # see `PressureRule`; a constant for a fixed pressure
        # (f,) bool, initial active set; nodes that penetrate at rest by default
        active: np.ndarray | None = None,
        max_iterations: int = 200,
    ) -> Obstacle:
        """Solve for u, λ and the pressure by `rule`."""
        order = self._order
        g = bound[order]
        guess = (g < 0.0) if active is None else active[order]
        now = guess & np.isfinite(g)
        fewest, patience, converged = len(g) + 1, 10, False
        u, reaction, pressure = np.zeros_like(g), np.zeros_like(g), 0.0
        steps = 0
        while steps < max_iterations and not converged:
            u, reaction, pressure = self._step(now, g, rule)
            steps += 1
            wrong = self._wrong(now, u, reaction, g)
            count = int(wrong.sum())
            converged = count == 0
            patience = 10 if count < fewest else patience - 1
            fewest = min(fewest, count)
            if patience > 0:
                now = now ^ wrong
            elif count:
                now = now.copy()
                now[np.flatnonzero(wrong)[-1]] ^= True
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        return Obstacle(u[back], reaction[back], pressure, now[back], steps, converged)

    def _step(
        self, active: np.ndarray, g: np.ndarray, rule: PressureRule
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Displacement, reaction and pressure with u = g held on the active nodes."""
        rest, held = np.flatnonzero(~active), np.flatnonzero(active)
        by_pressure, by_object = np.zeros_like(g), np.zeros_like(g)
        by_object[held] = g[held]
        if len(rest):
            rows = self._laplacian[rest]
            factor = symmetric_lu(rows[:, rest].tocsc(), "NATURAL")
            pull = -(rows[:, held] @ g[held]) if len(held) else np.zeros(len(rest))
            both = factor.solve(np.stack([self._areas[rest], pull], axis=1))
            by_pressure[rest], by_object[rest] = both.T
        pressure = rule(float(self._gradient @ by_object), float(self._gradient @ by_pressure))
        u = by_object + pressure * by_pressure
        reaction = np.zeros_like(g)
        reaction[held] = pressure * self._areas[held] - self._laplacian[held] @ u
        return u, reaction, pressure

    def _wrong(
        self, active: np.ndarray, u: np.ndarray, reaction: np.ndarray, g: np.ndarray
    ) -> np.ndarray:
        """Active nodes with a tensile reaction and inactive ones that penetrate."""
        scale = max(float(np.abs(u).max()), 1e-9)
        pulls = reaction < -1e-11 * scale * self._diagonal
        return np.where(active, pulls, u > g + 1e-11 * scale)


@dataclass(frozen=True)
class Contact:
    """Equilibrium of the membrane pressed by a rigid object, with its residuals."""

    displacement_m: np.ndarray  # (n,), u along the reference normals, m; 0 on the rim
    displacement_3d_m: np.ndarray  # (n, 3), the whole displacement, m
    contact_pressure_pa: np.ndarray  # (n,), p_c ≥ 0, Pa
    nodal_force_n: np.ndarray  # (n, 3), of the object on the membrane, N
    # (n,), bound g on u from the object, m; inf where its normal line does not meet it
    gap_m: np.ndarray
    gas_pressure_change_pa: float  # p_v, Pa
    complementarity: float  # max |φ p_c| with φ = g − u, Pa·m (Eq. 13)
    penetration_m: float  # max(u − g, 0) over the free nodes, m
    # the same on the clamped rim, which cannot move; above 0 the object touches the rim
    rim_penetration_m: float
    # max |K u − A p_v + A∘p_c| relative to the largest of its terms (Eq. 5)
    balance_residual: float
    gas_law_residual: float  # |P(V(u)) − P0 − p_v| / P0
    iterations: int  # sparse factorisations
    converged: bool  # contact and gas law both hold


class ForwardModel:
    """Presses rigid objects into one linear membrane (Eq. 16).

    The gas law is met exactly in every step of the contact solver. (The paper's fixed point
    p ← p + ω (P(V) − P0 − p) diverges where the gas is stiff.)
    """

    def __init__(self, mesh: MembraneMesh, tension_n_per_m: float, gas: Gas) -> None:
        if not (np.isfinite(tension_n_per_m) and tension_n_per_m > 0.0):
            raise InputError(
                f"tension {tension_n_per_m} N/m: not a finite number above 0; correct tension or "
                "gauge pressure in the sensor file"
            )
        self.mesh, self.tension, self.gas = mesh, tension_n_per_m, gas
        self._finder = GapFinder(mesh)
        self._laplacian = cotangent_laplacian(mesh)
        free = mesh.free
        self._solver = ObstacleSolver(
            self._laplacian[free][:, free], mesh.areas[free], gas.dV_du[free]
        )
        self._active: np.ndarray | None = None

    def press(self, obj: RigidObject, T_B_O: np.ndarray) -> Contact:
        """Equilibrium with the object at the pose, warm-started from the last call."""
        lowest = (obj.vertices @ T_B_O[2, :3]).min() + T_B_O[2, 3]
        if lowest > self.mesh.nodes[:, 2].max():  # above the membrane: needs no search, no Open3D
            return self.solve(np.full(len(self.mesh.nodes), np.inf))
        return self.solve(self._finder.gaps(obj, T_B_O))

    def forget(self) -> None:
        """Discard the warm start of the next call."""
        self._active = None

    def solve(self, gap_m: np.ndarray) -> Contact:
        """Equilibrium under given bounds g (n,) on the displacement, m."""

        def rule(volume: float, slope: float) -> float:  # at which gas law and membrane agree
            return self.gas.at(volume, max(slope, 0.0) / self.tension)[0] / self.tension

        state = self._solver.solve(gap_m[self.mesh.free], rule, self._active)
        self._active = state.active if state.converged else None
        return self._certified(state, gap_m)

    def _certified(self, state: Obstacle, gap_m: np.ndarray) -> Contact:
        """Fields of all nodes, and residuals computed from them."""
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
            iterations=state.iterations,
            converged=state.converged and bool(np.isfinite(u).all()),
        )
