"""Rigid objects pressed into the exact membrane, without friction, against the gas behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bubbleviz.membrane.forward_model import Contact, ForwardModel
from bubbleviz.membrane.gap import checked_pose
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.rubber_model.contact_step import Step
from bubbleviz.membrane.rubber_model.object_surface import ObjectSurface, Planes
from bubbleviz.membrane.rubber_model.rubber_contact import Missed, RubberAndGas, RubberContact
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.rigid_object import RigidObject

_STEPS, _PATIENCE = 60, 10
"""Steps of Newton's method for one pose, and how many may pass without halving what is missed."""
_SHORTEST = 0.02
"""Step of the object over the reach of its surface below which moving it in is given up."""
_FINE_M = 1e-6
"""Motion below which steps are taken whole: facets of the object are rougher than that, and energy
and penetration do not say how good so small a step is."""
_SHORT = 0.05  # motion over the reach of the object's surface that is short
_FLATTEST = 1e-4  # share of the slope by which the energy must fall for a step to be taken (Armijo)


@dataclass(frozen=True)
class _State:
    """A place on the way to equilibrium."""

    x: np.ndarray  # (n, 3), nodes, m
    load: np.ndarray  # (n,), contact force along the object's normal, N
    planes: Planes  # the object's, at x


@dataclass(frozen=True)
class _Solved:
    state: _State
    missed: Missed
    stable: bool
    factorisations: int

    @property
    def accepted(self) -> bool:
        return self.missed.accepted and self.stable


@dataclass(frozen=True)
class PressStart:
    """A place near an equilibrium."""

    displacement_3d_m: np.ndarray  # (n, 3)
    contact_pressure_pa: np.ndarray  # (n,)


class RubberForward:
    """Presses rigid objects into one exact membrane.

    Minimises the energy of membrane and gas over positions with no node inside the object:
    sequential quadratic programmes with the half-spaces of its surface nearest to the nodes, and a
    line search on the energy, in which penetration has a price. On a curved object corners keep as
    far away as flat triangles would cut into it. It starts from the linear model's
    equilibrium, and where that fails moves the object in from outside in steps. What it finds does
    not depend on the poses before.
    """

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas,  # P0 and V0 of the reference configuration
        rounding_m: float = 0.0,  # radius that sharp edges of the objects are given, m
    ) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self._pressed, self._rounding_m = RubberAndGas(membrane, gas), rounding_m
        self._linear = ForwardModel(self.mesh, membrane.mean_tension, gas)
        self._surface: ObjectSurface | None = None

    def press(
        self,
        obj: RigidObject,
        T_B_O: np.ndarray,  # (4, 4)
        near: PressStart | None = None,  # where to look first
        *,
        # be content with what is found from there and from the linear model's equilibrium, even if
        # it has not converged
        quick: bool = False,
    ) -> RubberContact:
        """Equilibrium with the object at the pose.

        Raises InputError: the pose is no rigid transform in metres.
        """
        pose = checked_pose(T_B_O)
        surface = self._surface_of(obj)
        self._linear.forget()
        linear = self._linear.press(obj, pose)
        starts = [PressStart(linear.displacement_3d_m, linear.contact_pressure_pa)]
        count = 0
        for start in starts if near is None else [near, *starts]:
            load = start.contact_pressure_pa * self.mesh.areas
            x = self.mesh.nodes + start.displacement_3d_m
            solved = self._solve(surface, pose, self._at(surface, pose, x, load))
            count += solved.factorisations
            if solved.accepted:
                break
        if not (solved.accepted or quick):
            solved = self._from_outside(surface, pose)
            count += solved.factorisations
        return self._certified(replace(solved, factorisations=count), linear)

    def _surface_of(self, obj: RigidObject) -> ObjectSurface:
        if self._surface is None or self._surface.object is not obj:
            self._surface = ObjectSurface(obj, self._rounding_m)
        return self._surface

    def _from_outside(self, surface: ObjectSurface, pose: np.ndarray) -> _Solved:
        """Equilibrium by moving the object in along −z, in steps that shrink where they fail."""
        way = self._pressed.clear_of(surface, pose)
        x, load = self.mesh.nodes, np.zeros(len(self.mesh.nodes))
        step, count = self._pressed.reach_m, 0
        while True:
            left = max(way - step, 0.0)
            lifted = pose.copy()
            lifted[2, 3] += left
            solved = self._solve(surface, lifted, self._at(surface, lifted, x, load))
            count += solved.factorisations
            if solved.accepted:
                x, load, way, step = solved.state.x, solved.state.load, left, 1.5 * step
            else:
                step = 0.4 * min(step, way)
            if way == 0.0 or step < _SHORTEST * self._pressed.reach_m:
                return replace(solved, factorisations=count)

    def _solve(self, surface: ObjectSurface, pose: np.ndarray, state: _State) -> _Solved:
        """Newton's method from a state, at one pose: the best of the states on the way."""
        price, since, count, stable = 0.0, 0, 0, self._rest_is_stable
        best, least = state, self._missed(state)
        moving = self.membrane.moving
        for _ in range(_STEPS):
            missed = self._missed(state)
            since = 0 if not count or missed.size < 0.5 * least.size else since + 1
            if missed.size < least.size:
                best, least = state, missed
            if least.size < 1.0 or (least.accepted and since > 1) or since > _PATIENCE:
                break
            newton = self._pressed.step(state.x, state.load, state.planes)
            step = newton.solve(state.load[moving] > 0.0)
            count += newton.factorisations
            if np.abs(step.motion).max() > self._pressed.reach_m:  # far off, loads turn too far
                newton = self._pressed.step(state.x, state.load, state.planes, turning=False)
                step = newton.solve(state.load[moving] > 0.0)
                count += newton.factorisations
            price = max(price, 2.0 * float(step.load.max(initial=0.0)))
            state = self._along(surface, pose, state, step, newton.residual, price, missed)
        if least.accepted and count:
            stable = newton.is_minimum()
        return _Solved(best, least, stable, count)

    @cached_property
    def _rest_is_stable(self) -> bool:
        rest = self.mesh.nodes
        step = self._pressed.step(rest, np.zeros(len(rest)), Planes.nowhere(len(rest)))
        return step.is_minimum()

    def _along(
        self,
        surface: ObjectSurface,
        pose: np.ndarray,
        state: _State,
        step: Step,
        residual: np.ndarray,
        price: float,
        missed: Missed,
    ) -> _State:
        """State as far along a step as energy and penetration fall together.

        Steps that are short for the mesh are taken whole where they come nearer to equilibrium.
        """
        moving = self.membrane.moving
        motion, load = np.zeros_like(state.x), np.zeros_like(state.load)
        motion[moving], load[moving] = step.motion, step.load
        inside = self._inside(state.planes)
        slope = float(np.sum(residual * step.motion)) - price * inside
        now = self._pressed.energy(state.x) + price * inside
        noise = 1e-13 * abs(now)
        most = max(float(np.abs(motion).max()), 1e-300)
        length = min(1.0, self._pressed.reach_m / most)

        def at(x: np.ndarray) -> tuple[_State, bool]:
            ahead = self._at(surface, pose, x, state.load + length * (load - state.load))
            value = self._pressed.energy(x) + price * self._inside(ahead.planes)
            return ahead, value <= now + _FLATTEST * length * slope + noise

        if most < _SHORT * self._pressed.reach_m:
            ahead, falls = at(state.x + motion)
            if falls or self._missed(ahead).size < 0.5 * missed.size:
                return ahead
        while True:
            ahead, falls = at(state.x + length * motion)
            if not falls and step.held.any():
                ahead, falls = at(self._put_back(ahead, state, moving[step.held], length))
            if falls or length < 1e-4 or most < _FINE_M:
                return ahead
            length *= 0.5

    def _put_back(
        self, ahead: _State, before: _State, held: np.ndarray, length: float
    ) -> np.ndarray:
        """Nodes (n, 3) with the `held` ones as far from the object as its planes would have them.

        A long step along a curved surface leaves it to second order, which would shorten the step
        again and again near the solution (Maratos).
        """
        gap, normal, _ = ahead.planes.of(held)
        off = gap - (1.0 - length) * before.planes.gap[held]
        x = ahead.x.copy()
        x[held] -= np.where(np.isfinite(off), off, 0.0)[:, None] * normal
        return x

    # -- what a state is ------------------------------------------------------------------------

    def _at(
        self, surface: ObjectSurface, pose: np.ndarray, x: np.ndarray, load: np.ndarray
    ) -> _State:
        return _State(x, load, self._pressed.planes(surface, pose, x))

    def _inside(self, planes: Planes) -> float:
        """Sum of the depths of the moving nodes in the object, m."""
        return float(np.maximum(-planes.gap[self.membrane.moving], 0.0).sum())

    def _missed(self, state: _State) -> Missed:
        return self._pressed.missed(state.x, state.load, state.planes)

    def _certified(self, solved: _Solved, linear: Contact) -> RubberContact:
        state = solved.state
        return self._pressed.contact(
            state.x,
            state.load,
            state.planes,
            nodal_force_n=state.load[:, None] * state.planes.normal,
            rim_penetration_m=linear.rim_penetration_m,
            missed=solved.missed,
            factorisations=solved.factorisations,
            converged=solved.accepted,
            stable=solved.stable,
        )
