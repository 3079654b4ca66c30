"""Exact membranes pressed by rigid objects, dragged and twisted by them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from bubbleviz.membrane.equilibrium import Equilibrium, RubberContact, Solved, State
from bubbleviz.membrane.forward_model import ForwardModel
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.object_surface import ObjectSurface
from bubbleviz.membrane.rubber import RubberMembrane
from bubbleviz.rigid_object import RigidObject

MOST_FRICTION = 5.0  # largest μ accepted: rubber on glass has 1 to 3
_MIN_APPROACH = 0.02  # least step of the object over `reach_m` before a press counts as failed
_STEP, _MIN_STEP = 0.25, 1.0 / 64.0
"""Motion of the object between two equilibria with friction in mesh edges, and the least share of
it before the equilibrium counts as failed."""


class RubberForward:
    """Moves rigid objects against one exact membrane."""

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas,  # P0 and V0 of the reference configuration
        # radii of rounding of objects' edges, as of `ObjectSurface`, m
        rounding_m: float = 0.0,
        sharp_m: float = 0.0,
    ) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self._equilibrium, self._radii_m = Equilibrium(membrane, gas), (rounding_m, sharp_m)
        self._linear = ForwardModel(self.mesh, membrane.mean_tension, gas)
        self._surface: ObjectSurface | None = None

    # -- without friction -----------------------------------------------------------------------

    def press(
        self,
        obj: RigidObject,
        T_B_O: np.ndarray,  # (4, 4)
        # initial state: displacement (n, 3), m, and contact pressure (n,), Pa
        near: tuple[np.ndarray, np.ndarray] | None = None,
        *,
        # only try the initial state and the linear model's equilibrium, even without convergence
        quick: bool = False,
    ) -> RubberContact:
        """Equilibrium with the object at the pose, without friction.

        Solved from the linear model's equilibrium, and if that fails by moving the object in from
        outside. The result does not depend on earlier poses.
        """
        surface, count = self._surface_of(obj), 0
        self._linear.forget()
        linear = self._linear.press(obj, T_B_O)
        starts = [(linear.displacement_3d_m, linear.contact_pressure_pa)]
        for moved, pressure in starts if near is None else [near, *starts]:
            start = State.free(self.mesh.nodes + moved, pressure * self.mesh.areas, T_B_O)
            solved = self._equilibrium.solve(surface, start)
            count += solved.factorisations
            if solved.accepted:
                break
        if not (solved.accepted or quick):
            solved = self._from_outside(surface, T_B_O)
            count += solved.factorisations
        solved = replace(solved, factorisations=count)
        return self._equilibrium.contact(solved, linear.rim_penetration_m)

    def _surface_of(self, obj: RigidObject) -> ObjectSurface:
        if self._surface is None or self._surface.obj is not obj:
            self._surface = ObjectSurface(obj, *self._radii_m)
        return self._surface

    def _from_outside(self, surface: ObjectSurface, pose: np.ndarray) -> Solved:
        """Equilibrium by moving the object in along −z, in steps that are shortened on failure."""
        height, reach_m = self._equilibrium.clearance(surface, pose), self._equilibrium.reach_m
        x, load = self.mesh.nodes, np.zeros(len(self.mesh.nodes))
        step, count = reach_m, 0
        while True:
            lower = max(height - step, 0.0)
            solved = self._equilibrium.solve(surface, State.free(x, load, _lifted(pose, lower)))
            count += solved.factorisations
            if solved.accepted:
                x, load = solved.at.state.x, solved.at.state.load
                height, step = lower, 1.5 * step
            else:
                step = 0.4 * min(step, height)
            if height == 0.0 or step < _MIN_APPROACH * reach_m:
                return replace(solved, factorisations=count)

    # -- with friction --------------------------------------------------------------------------

    def follow(
        self,
        obj: RigidObject,
        # (4, 4), T_B_O; if the first is in contact, the object approaches it along −z of B
        poses: Iterable[np.ndarray],
        friction: float,  # Coulomb's μ, above 0
        # frictionless contact at the first pose, in which the nodes stick from then on
        start: RubberContact | None = None,
    ) -> Iterator[RubberContact]:
        """Equilibria with the object at poses, one after the other, until there is none.

        Each is solved from the one before, in steps of a quarter of an edge or less, as sticking
        and sliding depend on the path. A node sticks from the end of the step in which it came into
        contact.
        """
        equilibrium = self._equilibrium.varied(friction=friction)
        surface, state = self._surface_of(obj), None
        for pose in poses:
            if state is None:
                state = self._initial(surface, pose, start)
            state, contact = _advance(equilibrium, surface, state, pose)
            yield contact
            if not contact.converged:  # later poses depend on it
                return

    def _initial(
        self, surface: ObjectSurface, pose: np.ndarray, start: RubberContact | None
    ) -> State:
        nodes = self.mesh.nodes
        if start is None:
            lifted = _lifted(pose, self._equilibrium.clearance(surface, pose))
            return State.free(nodes, np.zeros(len(nodes)), lifted)
        load = np.linalg.norm(start.nodal_force_n, axis=1)
        return _anchored(State.free(nodes + start.displacement_3d_m, load, pose))


def _lifted(pose: np.ndarray, height_m: float) -> np.ndarray:
    lifted = pose.copy()
    lifted[2, 3] += height_m
    return lifted


def _advance(
    equilibrium: Equilibrium, surface: ObjectSurface, state: State, end: np.ndarray
) -> tuple[State, RubberContact]:
    """State and contact at a pose, in steps along the straight path to it."""
    begin, vertices = state.pose, surface.obj.vertices
    turns = Slerp([0.0, 1.0], Rotation.from_matrix([begin[:3, :3], end[:3, :3]]))
    moved = end - begin
    path = float(np.linalg.norm(vertices @ moved[:3, :3].T + moved[:3, 3], axis=1).max())
    most = min(1.0, _STEP * equilibrium.mesh.edge_length / max(path, 1e-12))
    done, step, count, slip, dissipated = 0.0, most, 0, np.zeros(len(state.x)), 0.0
    while True:
        share, pose = done + step, end
        if share < 1.0 - 1e-9:
            pose = np.eye(4)
            pose[:3, :3] = turns(share).as_matrix()
            pose[:3, 3] = (1.0 - share) * begin[:3, 3] + share * end[:3, 3]
        solved = equilibrium.solve(surface, _moved_along(equilibrium, state, pose))
        count += solved.factorisations
        law = solved.at.law
        assert law is not None
        if solved.accepted:
            slipped = np.linalg.norm(law.slip, axis=1)
            slip += slipped
            dissipated += float(np.linalg.norm(law.pull, axis=1) @ slipped)
            # anchors at the points that nodes slipped to, or came into contact with
            anchors = solved.at.state.anchors + law.slip @ pose[:3, :3]
            state = _anchored(replace(solved.at.state, anchors=anchors, pull=law.pull))
            done, step = min(share, 1.0), min(most, 2.0 * step)
        else:
            step *= 0.5
        if (pose is end and solved.accepted) or step < _MIN_STEP * most:
            contact = equilibrium.contact(replace(solved, factorisations=count))
            slip = np.where(solved.at.state.load > 0.0, slip, 0.0)
            return state, replace(contact, slip_m=slip, dissipated_j=dissipated)


def _moved_along(equilibrium: Equilibrium, before: State, pose: np.ndarray) -> State:
    """The state with the touching nodes moved with the object."""
    x, turn = before.x.copy(), pose[:3, :3] @ before.pose[:3, :3].T
    moving = np.isin(np.arange(len(x)), equilibrium.membrane.moving)
    held = np.flatnonzero(np.isfinite(before.anchors[:, 0]) & moving)
    x[held] = (x[held] - before.pose[:3, 3]) @ turn.T + pose[:3, 3]
    return replace(before, x=x, pull=before.pull @ turn.T, pose=pose)


def _anchored(state: State) -> State:
    """The state with anchors at exactly the touching nodes."""
    fresh = (state.x - state.pose[:3, 3]) @ state.pose[:3, :3]
    anchors = np.where(np.isfinite(state.anchors), state.anchors, fresh)
    anchors[~(state.load > 0.0)] = np.nan
    return replace(state, anchors=anchors)
