"""One step of Newton's method with contact: a quadratic programme over half-spaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bubbleviz.membrane.object_surface import Planes
from bubbleviz.membrane.sparse_factor import Factor, Factoriser, FrictionConstraint, NodeBlocks

_ROUNDS = 12  # changes of the active set in one step; the next step continues with it
_SHIFTS = (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0)
"""Shares of the mean diagonal, added to a tangent until its step decreases the energy."""


@dataclass(frozen=True)
class Step:
    """Solution of a quadratic programme."""

    motion: np.ndarray  # (f, 3), m
    load: np.ndarray  # (f,), contact force along each plane's normal, N, not below 0
    held: np.ndarray  # (f,) bool, nodes on their planes
    pull: np.ndarray  # (f, 3), reaction forces of the nodes, N: 0 for free ones


class ContactStep:
    """min ½ δᵀ (K + β g gᵀ) δ + rᵀ δ over the half-spaces n·δ ≥ −gap of the moving nodes."""

    def __init__(
        self,
        # factoriser, blocks: of K's pattern
        factoriser: Factoriser,
        blocks: NodeBlocks,
        # (nnz,), of K, N/m: the tangent minus the rotation of loads with the object's surface,
        # which lets Newton's method converge quadratically on curved objects
        data: np.ndarray,
        # residual, gradient: (f, 3), r in N and g = ∂V/∂x in m²
        residual: np.ndarray,
        gradient: np.ndarray,
        beta: float,  # stiffness of the gas −dp/dV, Pa/m³
        planes: Planes,  # of the moving nodes
        # friction, none by default; with it the forces have no energy, and the step solves for
        # their balance
        grip: FrictionConstraint | None = None,
    ) -> None:
        self._factoriser, self._blocks, self._data = factoriser, blocks, data
        self.residual, self._gradient, self._beta, self._planes = residual, gradient, beta, planes
        self._grip = grip
        self.factorisations = 0
        self._last: tuple[Factor, np.ndarray] | None = None

    def solve(self, held: np.ndarray) -> Step:
        """Solve with the initial active set `held` (f,), the nodes on their planes.

        If the tangent is indefinite and the step does not decrease the energy, the tangent is
        shifted until it does.
        """
        for shift in _SHIFTS:
            data = self._blocks.shifted(self._data, shift) if shift else self._data
            step = self.direct(held, data)
            if self.slope(step) < 0.0 or not step.motion.any():
                break
        return step

    def slope(self, step: Step) -> float:
        """Change of the energy along a step, penetration penalised by twice the largest load, J."""
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
        """Motion with the held nodes on their planes and equilibrium in all other directions."""
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
        """Whether the energy is convex in all directions that keep held nodes on their planes."""
        if self._last is None:
            self._motion(self._data, np.zeros(len(self.residual), bool))
        assert self._last is not None
        factor, gradient = self._last
        downward = factor.negative_directions()
        if downward == 1:  # the gas may stabilise one
            return 1.0 + self._beta * float(gradient @ factor.solve(gradient)) < 0.0
        return downward == 0


def _across(
    vectors: np.ndarray,
    nodes: np.ndarray,
    normal: np.ndarray,
    grip: FrictionConstraint | None = None,
) -> np.ndarray:
    """Vectors (f, 3) without the components that planes and friction constrain at nodes (k,)."""
    out = vectors.copy()
    along = np.einsum("ij,ij->i", out[nodes], normal)
    out[nodes] -= along[:, None] * normal
    if grip is not None:
        out[nodes] += along[:, None] * grip.drag
        out[nodes[grip.stuck]] = 0.0
    return out


# Coulomb's law of dry friction at the nodes of a contact, by return mapping.
#
# A node sticks to its anchor, the point of the object that it touched, while this needs at most μ
# times the normal force. Otherwise it slips: the force has that magnitude, opposite to the
# tangential displacement s from the anchor. With the pull q = −t on the object and any weight r > 0
# both cases are one equation (Alart and Curnier), q = q + r s cut to the length μ f_n, which
# Newton's method linearises.


_MIN_SLIP = 1e-6
"""Least value of |q + r s| over its bound, minus 1, in the tangent: smaller values make it
numerically singular."""


class Friction(NamedTuple):
    """Friction forces of nodes that stick or slip, with their tangent."""

    pull: np.ndarray  # (k, 3), tangential force of the nodes on the object by the law, N
    slip: np.ndarray  # (k, 3), s of nodes that slip, m
    grip: FrictionConstraint  # for a step from here
    # (k, 3, 3), of the pull across the direction of slip, and as the normal turns, N/m
    stiffness: np.ndarray
    start: np.ndarray  # (k, 3), part of the pull that this stiffness has contributed, N

    @classmethod
    def at(
        cls,
        # (k, 3), from the nodes' anchors to the nodes, m; NaN where they have none
        from_anchors: np.ndarray,
        pull: np.ndarray,  # (k, 3), q so far, N
        load: np.ndarray,  # (k,), f_n, N
        planes: Planes,  # the object's, at the nodes
        coefficient: float,  # μ
        weight: float,  # r, N/m
    ) -> Friction:
        """Coulomb's law at a state."""
        anchored, normal = np.isfinite(from_anchors[:, 0]) & (load > 0.0), planes.normal
        plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        s = np.einsum("kij,kj->ki", plane, np.where(anchored[:, None], from_anchors, 0.0))
        trial = np.einsum("kij,kj->ki", plane, np.where(anchored[:, None], pull, 0.0)) + weight * s
        size, most = np.linalg.norm(trial, axis=1), coefficient * load
        slips = anchored & (size > most)
        direction = np.where(slips[:, None], trial, 0.0) / np.where(slips, size, 1.0)[:, None]
        drag = coefficient * direction
        pulled = np.where(slips[:, None], load[:, None] * drag, trial)
        # Slip turns the force: q = μ f_n s/|s|, of which |q + r s| − μ f_n = r |s|.
        turning = plane - direction[:, :, None] * direction[:, None, :]
        beyond = np.maximum(size - most, _MIN_SLIP * most)
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
