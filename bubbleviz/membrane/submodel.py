"""Submodel: part of an exact membrane, optionally refined; the rest is condensed onto it.

With K and g = ∂V/∂x of the rest at the reference surface, its border b and its other nodes f:

    S = K_bb − K_bf K_ff⁻¹ K_fb,   ĝ = g_b − K_bf K_ff⁻¹ g_f,   c = g_fᵀ K_ff⁻¹ g_f

are its stiffness, and its volume change by motion of the border and by gas pressure.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.membrane.gas import Gas, HeldPressure
from bubbleviz.membrane.meshing import part_of, refinement
from bubbleviz.membrane.rubber import RubberMembrane
from bubbleviz.membrane.sparse_factor import Factor, Factoriser, condensed


class Tangent(NamedTuple):
    """Factorised tangent at a shape."""

    factor: Factor
    gas: np.ndarray  # (3f,), volume change by motion of the moving nodes, m²
    stiffness: float  # −dp/dV of the gas, Pa/m³
    moving: np.ndarray  # (f,) int

    def moved(self, forces: np.ndarray) -> np.ndarray:
        """Motions (j, k, 3) of the nodes under forces (j, k, 3) on them."""
        right = np.ascontiguousarray(forces[:, self.moving].reshape(len(forces), -1).T)
        found = self.factor.solve_with(right, self.gas, self.stiffness)
        motions = np.zeros_like(forces)
        motions[:, self.moving] = found.T.reshape(len(forces), -1, 3)
        return motions


class Submodel:
    """The membrane around one point.

    Attributes
    ----------
    mesh : MembraneMesh
        Of the part, k nodes.
    ends : (k, 2) int array
        Nodes of the whole mesh that each lies midway between, as of `Refined`.
    """

    def __init__(
        self,
        whole: RubberMembrane,  # its rim clamped
        center: np.ndarray,  # (3,), on the reference surface
        reach_m: float,  # triangles with a node closer than this are inside
        finer_m: float = 0.0,  # those with a node closer than this are cut into four
    ) -> None:
        self._center, self._reach_m = center, reach_m
        away = np.linalg.norm(whole.mesh.nodes - center, axis=1)[whole.mesh.triangles].min(axis=1)
        inside, outside = np.flatnonzero(away < reach_m), np.flatnonzero(away >= reach_m)
        nodes, part = part_of(whole.mesh, inside)
        finer = refinement(part, away[inside] < finer_m)
        self.mesh, self.ends = finer.mesh, nodes[finer.ends]
        self._inner = whole.on(self.mesh, inside[finer.parent])
        self._moving, self._gauge_pa = self._inner.moving, whole.gauge_pressure_pa
        self._rest_volume = self._inner.volume(self.mesh.nodes)
        self._border = np.zeros(0, int)
        self._stiffness, self._gradient, self._compliance = np.zeros((0, 0)), np.zeros(0), 0.0
        if len(outside):
            self._condense(whole, outside)
        self._merge()

    def _condense(self, whole: RubberMembrane, outside: np.ndarray) -> None:
        """Border, S, ĝ and c of the rest, in the order of the border's rows inside."""
        nodes, part = part_of(whole.mesh, outside)
        outer = whole.on(part, outside)
        moving, own = nodes[outer.moving], self.ends[self._moving]
        number = np.full(len(whole.mesh.nodes), -1)
        same = np.flatnonzero(own[:, 0] == own[:, 1])
        number[own[same, 0]] = same
        shared = number[moving] >= 0
        b = _rows(np.flatnonzero(shared))
        self._border = _rows(number[moving[shared]])
        K = outer.tangent(part.nodes, self._gauge_pa)
        g = outer.volume_gradient(part.nodes)[outer.moving].ravel()
        if shared.all():
            self._stiffness, self._gradient = K[b][:, b].toarray(), g[b]
            return
        rest = condensed(K, g, b)
        self._stiffness, self._gradient = rest[1:, 1:], rest[1:, 0]
        self._compliance = -float(rest[0, 0])

    def _merge(self) -> None:
        """Joint sparsity pattern of the tangent inside and the dense S, and places in it."""
        own = self._inner.tangent(self.mesh.nodes, 0.0)
        size = own.shape[0]
        columns = np.repeat(np.arange(size), np.diff(own.indptr))
        outer = (self._border[:, None] * size + self._border).ravel()
        both = np.concatenate([columns * size + own.indices, outer])
        keys, places = np.unique(both, return_inverse=True)
        self._inner_places, self._outer_places = np.split(places, [own.nnz])
        columns, rows = np.divmod(keys, size)
        starts = np.searchsorted(columns, np.arange(size + 1))
        pattern = sparse.csc_array((np.ones(len(keys)), rows, starts), shape=(size, size))
        self._factoriser, self._entries = Factoriser(pattern), len(keys)
        row = np.full((len(self.mesh.nodes), 3), -1)
        row[self._moving] = np.arange(size).reshape(-1, 3)
        of_triangle = row[self.mesh.triangles].reshape(-1, 9)
        pairs = of_triangle[:, None] * size + of_triangle[:, :, None]
        free = (of_triangle[:, None] >= 0) & (of_triangle[:, :, None] >= 0)
        found = np.where(free, np.searchsorted(keys, pairs), len(keys))
        self._triangle_places = found.reshape(-1, 81)  # of rows by columns; last where clamped

    def covers(self, center: np.ndarray, reach_m: float) -> bool:
        """Whether the part contains all within a distance of a point."""
        return float(np.linalg.norm(center - self._center)) + reach_m <= self._reach_m

    def linearised(
        self,
        # x, forces: (k, 3), nodes, m, and forces on them, N
        x: np.ndarray,
        forces: np.ndarray,
        # (c,) int, (c, 9, 9): loaded triangles, and stiffness, symmetric or not, of what loads them
        loaded: np.ndarray,
        added: np.ndarray,
        gas: Gas | HeldPressure,
    ) -> tuple[Tangent, np.ndarray]:
        """Tangent at nodes x (k, 3), and the residual forces (k, 3)."""
        inner = self._inner
        border = (x - self.mesh.nodes)[self._moving].ravel()[self._border]
        growth = inner.volume(x) - self._rest_volume + float(self._gradient @ border)
        change, weight = gas.at(growth, self._compliance)
        residual = forces - inner.residual(x, self._gauge_pa + change)
        rest = np.zeros(3 * len(self._moving))
        rest[self._border] = self._stiffness @ border - change * self._gradient
        residual[self._moving] -= rest.reshape(-1, 3)
        places = self._triangle_places[loaded].ravel()
        data = np.zeros(self._entries)
        data += np.bincount(places, added.ravel(), minlength=self._entries + 1)[:-1]
        data[self._inner_places] += inner.tangent(x, self._gauge_pa + change).data
        data[self._outer_places] += self._stiffness.T.ravel()
        gradient = inner.volume_gradient(x)[self._moving].ravel()
        gradient[self._border] += self._gradient
        return Tangent(self._factoriser.factor(data), gradient, weight, self._moving), residual


def _rows(nodes: np.ndarray) -> np.ndarray:
    """Rows (3k,) of nodes (k,)."""
    return (3 * nodes[:, None] + np.arange(3)).ravel()
