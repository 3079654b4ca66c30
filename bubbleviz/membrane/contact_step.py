"""One step of Newton's method with contact: a quadratic programme over half-spaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bubbleviz.membrane.object_surface import Planes
from bubbleviz.membrane.sparse_factor import Factor, Factoriser, FrictionConstraint, NodeBlocks

_ROUNDS = 12  # changes of the active set in one step; the next step goes on from where it ended
_SHIFTS = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0)
"""Shares of the mean diagonal added to a tangent along which the energy would not fall."""


@dataclass(frozen=True)
class Step:
    """Solution of a quadratic programme."""

    motion: np.ndarray  # (f, 3), m
    load: np.ndarray  # (f,), contact force along each plane's normal, N, not below 0
    held: np.ndarray  # (f,) bool, nodes on their planes
    pull: np.ndarray  # (f, 3), what must hold the nodes, N: 0 for those that are free


class ContactStep:
    """min ½ δᵀ (K + β g gᵀ) δ + rᵀ δ over the half-spaces n·δ ≥ −gap of the moving nodes."""

    def __init__(
        self,
        # factoriser, blocks: of K's pattern
        factoriser: Factoriser,
        blocks: NodeBlocks,
        # (nnz,), of K, N/m: the tangent less the loads' turning with the object's surface, which
        # lets Newton's method converge quadratically on curved objects
        data: np.ndarray,
        # residual, gradient: (f, 3), r in N and g = ∂V/∂x in m²
        residual: np.ndarray,
        gradient: np.ndarray,
        beta: float,  # stiffness of the gas −dp/dV, Pa/m³
        planes: Planes,  # of the moving nodes
        # friction, none by default. The forces have no energy then, and the step goes to where they
        # are in balance.
        grip: FrictionConstraint | None = None,
    ) -> None:
        self._factoriser, self._blocks, self._data = factoriser, blocks, data
        self.residual, self._gradient, self._beta, self._planes = residual, gradient, beta, planes
        self._grip = grip
        self.factorisations = 0
        self._last: tuple[Factor, np.ndarray] | None = None

    def solve(self, held: np.ndarray) -> Step:
        """Solve, beginning with the nodes `held` (f,) on their planes.

        Where the tangent is indefinite, so that the energy would not fall along the solution, it is
        stiffened until it does.
        """
        for shift in _SHIFTS:
            data = self._blocks.shifted(self._data, shift) if shift else self._data
            step = self.direct(held, data)
            if self.slope(step) < 0.0 or not step.motion.any():
                break
        return step

    def slope(self, step: Step) -> float:
        """Fall of the energy along a step, penetration paid for at twice the largest load, J."""
        inside = np.maximum(-self._planes.gap, 0.0).sum()
        energy = float(np.sum(self.residual * step.motion))
        return energy - 2.0 * float(step.load.max(initial=0.0)) * float(inside)

    def direct(self, held: np.ndarray, data: np.ndarray | None = None) -> Step:
        """Solve with the tangent, or that of other data (nnz,), by a primal-dual active set."""
        data = self._data if data is None else data
        gap, normal = self._planes.gap, self._planes.normal
        near = np.isfinite(gap)
        held = held & near
        for _ in range(_ROUNDS):
            motion = self._motion(data, held)
            pull = self.residual + self._blocks.times(data, motion)
            pull += self._beta * np.sum(self._gradient * motion) * self._gradient
            load = np.where(held, np.einsum("ij,ij->i", pull, normal), 0.0)
            across = np.einsum("ij,ij->i", motion, normal)
            tolerance = 1e-12 + 1e-9 * float(np.abs(motion).max())
            following = np.where(held, load > 0.0, near & (across < -gap - tolerance))
            if (following == held).all():
                break
            held = following
        return Step(motion, np.maximum(load, 0.0), held, pull)

    def _motion(self, data: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Motion at which all forces across the planes of the held nodes vanish."""
        nodes = np.flatnonzero(held)
        normal = self._planes.normal[nodes]
        to_plane = np.zeros_like(self.residual)
        to_plane[nodes] = -self._planes.gap[nodes, None] * normal
        grip = None if self._grip is None else self._grip.of(nodes)
        if grip is not None:
            to_plane[nodes] += grip.back
        right = -self.residual - self._blocks.times(data, to_plane)
        right -= self._beta * np.sum(self._gradient * to_plane) * self._gradient
        right = _across(right, nodes, normal, grip)
        gradient = _across(self._gradient, nodes, normal)
        pushed = gradient
        if grip is not None:
            gradient[nodes[grip.stuck]] = 0.0
            pushed = _across(self._gradient, nodes, normal, grip)
        factor = self._factoriser.factor(self._blocks.held(data, nodes, normal, grip))
        self.factorisations += 1
        self._last = factor, gradient.ravel()
        free = factor.solve_with(right.ravel(), pushed.ravel(), self._beta, gradient.ravel())
        return to_plane + free.reshape(-1, 3)

    def is_minimum(self) -> bool:
        """Whether the energy curves upwards in every direction that the held nodes leave free."""
        if self._last is None:
            self._motion(self._data, np.zeros(len(self.residual), bool))
        assert self._last is not None
        factor, gradient = self._last
        downward = factor.negative_directions()
        if downward == 1:  # the gas may hold one
            return 1.0 + self._beta * float(gradient @ factor.solve(gradient)) < 0.0
        return downward == 0


def _across(
    vectors: np.ndarray,
    nodes: np.ndarray,
    normal: np.ndarray,
    grip: FrictionConstraint | None = None,
) -> np.ndarray:
    """Vectors (f, 3) without what planes and friction take at some nodes (k,)."""
    out = vectors.copy()
    along = np.einsum("ij,ij->i", out[nodes], normal)
    out[nodes] -= along[:, None] * normal
    if grip is not None:
        out[nodes] += along[:, None] * grip.drag
        out[nodes[grip.stuck]] = 0.0
    return out


# Coulomb's law of dry friction at the nodes of a contact, by return mapping.
#
# A node sticks to the place of the object that it touched, its anchor, as long as that takes no
# more than μ times the contact force along the normal. Else it slips: the force is at that bound,
# against the way s from the anchor across the normal. With the pull q = −t on the object and any
# weight r > 0 both are one equation (Alart and Curnier), q = q + r s cut to the length μ f_n, whose
# derivative Newton's method takes.


_LEAST_SLIP = 1e-6
"""Of |q + r s| over its bound, less 1: a node that only begins to slip does not turn aside, and a
stiffer tangent is singular to rounding."""


class Friction(NamedTuple):
    """Nodes that stick and slip at some place, near an equilibrium or in it."""

    pull: np.ndarray  # (k, 3), of the nodes on the object across its normals by the law, N
    slip: np.ndarray  # (k, 3), s of nodes that slip, m
    grip: FrictionConstraint  # for a step from here
    # (k, 3, 3), of the pull across the direction of slip, and as the normal turns, N/m
    stiffness: np.ndarray
    start: np.ndarray  # (k, 3), the part of the pull that this stiffness has added so far, N

    @classmethod
    def at(
        cls,
        # (k, 3), from the nodes' anchors to the nodes, m; NaN where they have none
        away: np.ndarray,
        pull: np.ndarray,  # (k, 3), q so far, N
        load: np.ndarray,  # (k,), f_n, N
        planes: Planes,  # the object's, at the nodes
        coefficient: float,  # μ
        weight: float,  # r, N/m
    ) -> Friction:
        """The law."""
        anchored, normal = np.isfinite(away[:, 0]) & (load > 0.0), planes.normal
        plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        s = np.einsum("kij,kj->ki", plane, np.where(anchored[:, None], away, 0.0))
        tried = np.einsum("kij,kj->ki", plane, np.where(anchored[:, None], pull, 0.0)) + weight * s
        size, most = np.linalg.norm(tried, axis=1), coefficient * load
        slips = anchored & (size > most)
        way = np.where(slips[:, None], tried, 0.0) / np.where(slips, size, 1.0)[:, None]
        drag = coefficient * way
        pulled = np.where(slips[:, None], load[:, None] * drag, tried)
        # Slip turns the force: q = μ f_n s/|s|, of which |q + r s| − μ f_n = r |s|.
        turning = plane - way[:, :, None] * way[:, None, :]
        beyond = np.maximum(size - most, _LEAST_SLIP * most)
        turning *= np.where(slips, most * weight / np.where(slips, beyond, 1.0), 0.0)[:, None, None]
        bent = np.einsum("ki,kij->kj", pulled, planes.turn)
        return cls(
            pulled,
            np.where(slips[:, None], s, 0.0),
            FrictionConstraint(
                anchored & ~slips, np.where((anchored & ~slips)[:, None], -s, 0.0), drag
            ),
            turning - normal[:, :, None] * bent[:, None, :],
            np.einsum("kij,kj->ki", turning, s),
        )
