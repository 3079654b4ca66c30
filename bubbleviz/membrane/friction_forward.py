"""Rigid objects that stick to the exact membrane and slide over it, by Coulomb's law."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from bubbleviz.errors import InputError
from bubbleviz.membrane.contact_step import Friction, Step
from bubbleviz.membrane.forward_model import checked_pose
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.object_surface import ObjectSurface, Planes
from bubbleviz.membrane.rubber import RubberMembrane
from bubbleviz.membrane.rubber_forward import Missed, RubberAndGas, RubberContact
from bubbleviz.rigid_object import RigidObject

MOST_FRICTION = 5.0  # μ above which it is taken for a mistake: rubber on glass has 1 to 3
_STEP = 0.25  # motion of the object between two equilibria over the mesh's edges
_SHORTEST = 1.0 / 64.0  # share of that below which an equilibrium is given up
_STEPS, _PATIENCE = 40, 8
"""Steps of Newton's method, and how many may pass without halving what is missed."""
_SHARES = (0.5, 0.25, 0.1)  # of a step that are tried where whole ones do not come nearer


@dataclass(frozen=True)
class FrictionContact(RubberContact):
    """Equilibrium with friction; `stable` where no pivot of the tangent is negative."""

    # (n,), way that each touching node slipped over the object since the contact before, m; 0 where
    # nothing touches
    slip_m: np.ndarray
    stick_error_m: float  # largest distance of a sticking node from its anchor, m
    # largest |t| of a node over μ times its load, less 1; 0 where none is above
    cone_violation: float
    dissipated_j: float  # work lost to slip since the contact before, J


@dataclass(frozen=True)
class _State:
    """Where membrane and object are, and what is between them."""

    x: np.ndarray  # (n, 3), nodes, m
    load: np.ndarray  # (n,), contact force along the object's normal, N
    pull: np.ndarray  # (n, 3), of the nodes on the object across its normal, N
    anchors: np.ndarray  # (n, 3), places on the object, in O, m; NaN for nodes that do not touch
    pose: np.ndarray  # (4, 4), T_B_O

    def away(self) -> np.ndarray:
        """From the anchors to the nodes, (n, 3), m."""
        away: np.ndarray = self.x - (self.anchors @ self.pose[:3, :3].T + self.pose[:3, 3])
        return away


@dataclass(frozen=True)
class _Solved:
    """A state and how good it is, with the law there."""

    state: _State
    planes: Planes
    law: Friction
    missed: Missed
    factorisations: int = 0
    stable: bool = True

    @property
    def accepted(self) -> bool:
        """Whether it is an equilibrium."""
        return self.missed.accepted and self.stable


class FrictionForward:
    """Moves rigid objects against one exact membrane, with friction.

    Each pose follows from the one before, in steps of a quarter of an edge or less, for sticking
    and sliding depend on the way. In a step, the law is implicit (backward Euler): Newton's method
    with its exact derivative, which is not symmetric where nodes slip, and an active set of the
    nodes that touch. A node sticks from the end of the step in which it was touched.

    Raises InputError: μ is out of range.
    """

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas,  # P0 and V0 of the reference configuration
        friction: float,  # coefficient μ, above 0
        rounding_m: float = 0.0,  # radius that sharp edges of the objects are given, m
    ) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self.friction = checked_friction(friction)
        self._pressed, self._rounding_m = RubberAndGas(membrane, gas), rounding_m

    def follow(
        self,
        obj: RigidObject,
        # (4, 4), T_B_O. Where the first already touches, the object has come there along −z of B.
        poses: Iterable[np.ndarray],
        # a contact at the first pose, without friction so far, in which the nodes stick from then
        # on
        start: RubberContact | None = None,
    ) -> Iterator[FrictionContact]:
        """Equilibria with the object at poses, one after the other.

        Raises InputError: a pose is no rigid transform in metres.
        """
        surface, state = ObjectSurface(obj, self._rounding_m), None
        for each in poses:
            pose = checked_pose(each)
            if state is None:
                state = self._begin(surface, pose, start)
            state, contact = self._move(surface, state, pose)
            yield contact
            if not contact.converged:  # what follows from it is not known
                return

    # -- from pose to pose ----------------------------------------------------------------------

    def _begin(
        self, surface: ObjectSurface, pose: np.ndarray, start: RubberContact | None
    ) -> _State:
        nodes = self.mesh.nodes
        nowhere = np.full(nodes.shape, np.nan)
        if start is None:
            lifted = pose.copy()
            lifted[2, 3] += self._pressed.clear_of(surface, pose)
            return _State(nodes, np.zeros(len(nodes)), np.zeros_like(nodes), nowhere, lifted)
        x = nodes + start.displacement_3d_m
        load = np.linalg.norm(start.nodal_force_n, axis=1)
        return _State(x, load, np.zeros_like(x), _anchors(x, load, pose), pose)

    def _move(
        self, surface: ObjectSurface, state: _State, pose: np.ndarray
    ) -> tuple[_State, FrictionContact]:
        """Equilibrium at a pose, by way of others, and what happened on the way."""
        motion = _Motion(state.pose, pose)
        way = motion.length(surface.object.vertices)
        most = min(1.0, _STEP * self.mesh.edge_length / max(way, 1e-12))
        done, step, count = 0.0, most, 0
        slip, lost = np.zeros(len(state.x)), 0.0
        while True:
            ahead = done + step if done + step < 1.0 - 1e-9 else 1.0
            solved = self._solve(surface, state, motion.at(ahead))
            count += solved.factorisations
            if solved.accepted:
                slipped = np.linalg.norm(solved.law.slip, axis=1)
                slip += slipped
                lost += float(np.linalg.norm(solved.law.pull, axis=1) @ slipped)
                state, done, step = _settled(solved), ahead, min(most, 2.0 * step)
            else:
                step *= 0.5
            if done == 1.0 or step < _SHORTEST * most:
                solved = replace(solved, factorisations=count)
                return state, self._certified(solved, slip, lost)

    # -- one step -------------------------------------------------------------------------------

    def _solve(self, surface: ObjectSurface, before: _State, pose: np.ndarray) -> _Solved:
        """Newton's method at a pose, from where nodes that touch have moved with the object."""
        solved = best = self._looked_at(surface, self._carried(before, pose))
        since, count, stable = 0, 0, True
        for _ in range(_STEPS):
            since = 0 if not count or solved.missed.size < 0.5 * best.missed.size else since + 1
            best = min(best, solved, key=lambda each: each.missed.size)
            missed = best.missed
            if missed.size < 1.0 or (missed.accepted and since > 1) or since > _PATIENCE:
                break
            state = solved.state
            newton = self._pressed.step(state.x, state.load, solved.planes, solved.law)
            try:
                step = newton.direct(state.load[self.membrane.moving] > 0.0)
            except RuntimeError:  # singular
                break
            count += newton.factorisations
            ahead = self._looked_at(surface, self._after(solved, step))
            if since or not np.isfinite(ahead.missed.size):  # round in circles, or too far
                shorter = (self._looked_at(surface, self._after(solved, step, s)) for s in _SHARES)
                ahead = min([ahead, *shorter], key=lambda each: each.missed.size)
            if not np.isfinite(ahead.missed.size):
                break
            solved = ahead
        if count and best.missed.accepted:
            stable = newton.is_minimum()
        return replace(best, factorisations=count, stable=stable)

    def _after(self, solved: _Solved, step: Step, share: float = 1.0) -> _State:
        """The state after a share of a step, or less of one that is long for the mesh."""
        state, law, moving = solved.state, solved.law, self.membrane.moving
        x, load, pull = state.x.copy(), state.load.copy(), state.pull.copy()
        length = min(share, self._pressed.reach_m / max(float(np.abs(step.motion).max()), 1e-300))
        x[moving] += length * step.motion
        load[moving] += length * (step.load - load[moving])
        grip, held = law.grip.of(moving), step.held[:, None]
        turned = law.start[moving] + np.einsum("kij,kj->ki", law.stiffness[moving], step.motion)
        slips = held & grip.drag.any(axis=1, keepdims=True)
        aim = np.where(slips, step.load[:, None] * grip.drag + turned, 0.0)
        across = step.load[:, None] * solved.planes.normal[moving] - step.pull
        aim = np.where(held & grip.stuck[:, None], across, aim)
        pull[moving] += length * (aim - pull[moving])
        return replace(state, x=x, load=load, pull=pull)

    def _carried(self, before: _State, pose: np.ndarray) -> _State:
        """The state with the nodes that touch moved as the object."""
        x, pull, turn = before.x.copy(), before.pull.copy(), pose[:3, :3] @ before.pose[:3, :3].T
        moving = np.isin(np.arange(len(x)), self.membrane.moving)
        held = np.flatnonzero(np.isfinite(before.anchors[:, 0]) & moving)
        x[held] = (x[held] - before.pose[:3, 3]) @ turn.T + pose[:3, 3]
        return replace(before, x=x, pull=pull @ turn.T, pose=pose)

    def _looked_at(self, surface: ObjectSurface, state: _State) -> _Solved:
        planes = self._pressed.planes(surface, state.pose, state.x)
        law = Friction.at(
            state.away(), state.pull, state.load, planes, self.friction, self._pressed.weight
        )
        off = float(np.abs(law.pull - state.pull).max())
        missed = self._pressed.missed(state.x, state.load, planes, -law.pull, off)
        away = float(np.linalg.norm(law.grip.back, axis=1).max())
        missed = replace(missed, distance_m=max(missed.distance_m, away))
        return _Solved(state, planes, law, missed)

    def _certified(self, solved: _Solved, slip: np.ndarray, dissipated_j: float) -> FrictionContact:
        state, law, planes = solved.state, solved.law, solved.planes
        still = np.setdiff1d(np.arange(len(state.x)), self.membrane.moving)
        across = np.linalg.norm(law.pull, axis=1)
        touching = state.load > 0.0
        over = across[touching] / (self.friction * state.load[touching]) - 1.0
        contact = self._pressed.contact(
            state.x,
            state.load,
            planes,
            nodal_force_n=state.load[:, None] * planes.normal - law.pull,
            rim_penetration_m=float(-planes.gap[still].min(initial=0.0)),
            missed=solved.missed,
            factorisations=solved.factorisations,
            converged=solved.accepted,
            stable=solved.stable,
        )
        return FrictionContact(
            **vars(contact),
            slip_m=np.where(touching, slip, 0.0),
            stick_error_m=float(np.linalg.norm(law.grip.back, axis=1).max()),
            cone_violation=float(over.max(initial=0.0)),
            dissipated_j=dissipated_j,
        )


def checked_friction(friction: float) -> float:
    """A coefficient of friction; InputError where it is out of range."""
    if not 0.0 < friction <= MOST_FRICTION:
        most = f"{MOST_FRICTION:g}"
        raise InputError(f"friction {friction:g}: give a number above 0, up to {most}")
    return friction


class _Motion:
    """The straight way from one pose to another, turning evenly."""

    def __init__(self, start: np.ndarray, end: np.ndarray) -> None:
        self._start, self._end = start, end
        self._turns = Slerp([0.0, 1.0], Rotation.from_matrix([start[:3, :3], end[:3, :3]]))

    def at(self, share: float) -> np.ndarray:
        """Pose (4, 4) after a share of the way."""
        if share == 1.0:
            return self._end
        pose = np.eye(4)
        pose[:3, :3] = self._turns(share).as_matrix()
        pose[:3, 3] = (1.0 - share) * self._start[:3, 3] + share * self._end[:3, 3]
        return pose

    def length(self, points: np.ndarray) -> float:
        """Longest way of points (k, 3) of the object, m."""
        moved = self._end - self._start
        return float(np.linalg.norm(points @ moved[:3, :3].T + moved[:3, 3], axis=1).max())


def _settled(solved: _Solved) -> _State:
    """The state with anchors where nodes have slipped to, or were touched."""
    state, pose = solved.state, solved.state.pose
    anchors = state.anchors + solved.law.slip @ pose[:3, :3]
    fresh = _anchors(state.x, state.load, pose)
    anchors = np.where(np.isfinite(anchors), anchors, fresh)
    anchors[~(state.load > 0.0)] = np.nan
    return replace(state, anchors=anchors, pull=solved.law.pull)


def _anchors(x: np.ndarray, load: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Places of touching nodes on the object, (n, 3), in O; NaN for others."""
    on_object = (x - pose[:3, 3]) @ pose[:3, :3]
    anchors: np.ndarray = np.where((load > 0.0)[:, None], on_object, np.nan)
    return anchors
