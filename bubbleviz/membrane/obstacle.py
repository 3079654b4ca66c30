"""The obstacle problem: a membrane under pressure that may not pass a bound (Eqs. 15 and 16)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from bubbleviz.membrane.symmetric_lu import symmetric_lu

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

    Every step fixes u = g on the active nodes, solves the rest, lets go of active nodes that
    pull and takes in nodes that penetrate. On a mesh whose Laplacian is an M-matrix (Delaunay)
    this goes down monotonically and ends after finitely many steps; where the number of wrong
    nodes stops falling (slivers), Júdice and Pires' rule of changing only the last wrong node
    takes over, which ends on any positive definite matrix.
    """

    def __init__(
        self,
        laplacian: sparse.csr_array,  # (f, f) sparse, cotangent Laplacian of the free nodes
        areas: np.ndarray,  # (f,), nodal areas, m²
        # (f,), volume change per displacement as the gas law has it, m²
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
        # (f,) bool, first guess of the nodes in contact; those that penetrate at rest by default
        active: np.ndarray | None = None,
        max_iterations: int = 200,
    ) -> Obstacle:
        """Solve for u, λ and the pressure that `rule` asks for."""
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
        """Active nodes that pull and inactive ones that penetrate, beyond rounding."""
        scale = max(float(np.abs(u).max()), 1e-9)
        pulls = reaction < -1e-11 * scale * self._diagonal
        return np.where(active, pulls, u > g + 1e-11 * scale)
