"""The membrane around a contact; the rest of it moves little, and is condensed onto the border.

With K and g = ∂V/∂x of the rest at the reference surface, its border b and its other nodes f:

    S = K_bb − K_bf K_ff⁻¹ K_fb,   ĝ = g_b − K_bf K_ff⁻¹ g_f,   c = g_fᵀ K_ff⁻¹ g_f

are its stiffness, and its change of volume by the border's motion and by the gas pressure.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factor, Factoriser


class Tangent(NamedTuple):
    """The factorised tangent at some nodes."""

    factor: Factor
    gas: np.ndarray  # (3f,), change of the volume by motions of the moving nodes, m²
    stiffness: float  # fall of the gas pressure with it, Pa/m³; 0 where the pressure is measured
    moving: np.ndarray  # (f,) int

    def moved(self, forces: np.ndarray) -> np.ndarray:
        """Motions (j, k, 3) of the nodes under forces (j, k, 3) on them."""
        right = np.ascontiguousarray(forces[:, self.moving].reshape(len(forces), -1).T)
        found = self.factor.solve_with(right, self.gas, self.stiffness)
        motions = np.zeros_like(forces)
        motions[:, self.moving] = found.T.reshape(len(forces), -1, 3)
        return motions


class Window:
    """Equilibrium of a membrane around one place.

    Attributes
    ----------
    center, reach_m
        As given.
    nodes : (k,) int array
        Of the whole mesh.
    mesh : MembraneMesh
        Inside; its nodes are those.
    """

    def __init__(
        self,
        membrane: RubberMembrane,  # the whole, its rim clamped
        gas: Gas,
        center: np.ndarray,  # (3,), on the reference surface
        reach_m: float,  # triangles with a node closer than this are inside
    ) -> None:
        self.center, self.reach_m = center, reach_m
        whole = membrane.mesh
        close = np.linalg.norm(whole.nodes - center, axis=1) < reach_m
        inside = close[whole.triangles].any(axis=1)
        self.nodes, self._inner = _part(membrane, inside)
        self.mesh = self._inner.mesh
        self._moving = self._inner.moving
        self._gauge_pa, self._gas = membrane.gauge_pressure_pa, gas
        self._rest_volume = self._inner.volume(self.mesh.nodes)
        self._condense(membrane, ~inside)
        pattern = self._inner.tangent(self.mesh.nodes, 0.0)
        self._merge(pattern.indices, pattern.indptr)

    def _condense(self, membrane: RubberMembrane, outside: np.ndarray) -> None:
        """Border, S, ĝ and c of the rest, in the order of the border's rows inside."""
        free = self.nodes[self._moving]
        self._border = np.zeros(0, int)
        self._stiffness, self._gradient, self._give = np.zeros((0, 0)), np.zeros(0), 0.0
        if not outside.any():
            return
        nodes, outer = _part(membrane, outside)
        moving = nodes[outer.moving]
        shared = np.isin(moving, free)
        b, f = (_rows(np.flatnonzero(some)) for some in (shared, ~shared))
        self._border = _rows(np.searchsorted(free, moving[shared]))
        rest = outer.mesh.nodes
        K = outer.tangent(rest, membrane.gauge_pressure_pa)
        g = outer.volume_gradient(rest)[outer.moving].ravel()
        self._stiffness, self._gradient = K[b][:, b].toarray(), g[b]
        if not len(f):
            return
        far = K[f][:, f].tocsc()
        far.sort_indices()
        right = np.column_stack([K[f][:, b].toarray(), g[f]])
        moved = Factoriser(far).factor(far.data).solve(right)
        back = right.T @ moved
        self._stiffness = self._stiffness - back[:-1, :-1]
        self._gradient = self._gradient - back[:-1, -1]
        self._give = float(back[-1, -1])

    def _merge(self, indices: np.ndarray, indptr: np.ndarray) -> None:
        """Pattern of the tangent inside and the dense S together."""
        size = len(indptr) - 1
        columns = np.repeat(np.arange(size), np.diff(indptr))
        inner = columns * size + indices
        outer = (self._border[:, None] * size + self._border).ravel()
        keys, places = np.unique(np.concatenate([inner, outer]), return_inverse=True)
        self._inner_places, self._outer_places = np.split(places, [len(inner)])
        columns, rows = np.divmod(keys, size)
        starts = np.searchsorted(columns, np.arange(size + 1))
        data = np.ones(len(keys))
        pattern = sparse.csc_array((data, rows, starts), shape=(size, size))
        self._factoriser, self._entries = Factoriser(pattern), len(keys)

    def covers(self, center: np.ndarray, reach_m: float) -> bool:
        """Whether all within some way of a place is inside."""
        return float(np.linalg.norm(center - self.center)) + reach_m <= self.reach_m

    def linearised(
        self,
        # x, forces: (k, 3), nodes, m, and forces on them, N
        x: np.ndarray,
        forces: np.ndarray,
        # (6, 3, 3, m), stiffness of what exerts them, as of `RubberMembrane.tangent`
        added: np.ndarray,
        gas_pressure_pa: float | None,  # absolute; by the gas law where it is not measured
    ) -> tuple[Tangent, np.ndarray]:
        """Tangent at nodes x (k, 3), and the forces (k, 3) that are missing for equilibrium."""
        inner = self._inner
        border = (x - self.mesh.nodes)[self._moving].ravel()[self._border]
        change, weight = self._gas_at(x, border, gas_pressure_pa)
        pressure = self._gauge_pa + change
        missed = forces - inner.residual(x, pressure)
        rest = np.zeros(3 * len(self._moving))
        rest[self._border] = self._stiffness @ border - change * self._gradient
        missed[self._moving] -= rest.reshape(-1, 3)
        data = np.zeros(self._entries)
        data[self._inner_places] = inner.tangent(x, pressure, added).data
        data[self._outer_places] += self._stiffness.T.ravel()
        gradient = inner.volume_gradient(x)[self._moving].ravel()
        gradient[self._border] += self._gradient
        return Tangent(self._factoriser.factor(data), gradient, weight, self._moving), missed

    def _gas_at(
        self, x: np.ndarray, border: np.ndarray, measured: float | None
    ) -> tuple[float, float]:
        """Change of the gas pressure, Pa, and its fall with the volume by motions inside, Pa/m³.

        The rest gives way by c to the pressure, (P0 + Δp)(V + c Δp) = P0 V0: the upper root.
        """
        P0, V0, c = self._gas.P0, self._gas.V0, self._give
        if measured is not None and np.isfinite(measured):
            return measured - P0, 0.0
        volume = V0 + self._inner.volume(x) - self._rest_volume + float(self._gradient @ border)
        if not volume > 0.0:
            return np.nan, 0.0
        sum_ = volume + c * P0
        change = 2.0 * P0 * (V0 - volume) / (sum_ + np.sqrt(sum_**2 + 4.0 * c * P0 * (V0 - volume)))
        beta = (P0 + change) / (volume + c * change)
        return change, beta / (1.0 + beta * c)


def _part(membrane: RubberMembrane, chosen: np.ndarray) -> tuple[np.ndarray, RubberMembrane]:
    """Nodes (k,) of some triangles (m,) bool, and the membrane that these are."""
    mesh = membrane.mesh
    nodes, triangles = np.unique(mesh.triangles[chosen], return_inverse=True)
    part = MembraneMesh(mesh.nodes[nodes], triangles.reshape(-1, 3), mesh.rim[nodes])
    return nodes, RubberMembrane(
        part, membrane.gauge_pressure_pa, membrane.inverse[chosen], membrane.mu_h[chosen]
    )


def _rows(nodes: np.ndarray) -> np.ndarray:
    """Rows (3k,) of nodes (k,)."""
    rows: np.ndarray = (3 * nodes[:, None] + np.arange(3)).ravel()
    return rows
