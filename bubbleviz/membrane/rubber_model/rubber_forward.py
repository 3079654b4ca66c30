"""Rigid objects pressed into the exact membrane, without friction, against the gas behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bubbleviz.membrane.forward_model import Contact, ForwardModel
from bubbleviz.membrane.gap import checked_pose
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.rubber_model.contact_step import ContactStep, Step
from bubbleviz.membrane.rubber_model.object_surface import MOST_TURN_RAD, ObjectSurface, Planes
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factoriser, NodeBlocks
from bubbleviz.rigid_object import RigidObject

BALANCE_AIM, BALANCE_ACCEPTED = 1e-7, 1e-6
"""Largest force left at a node over the largest load on one: what is aimed at, and what will do
where facets of the object keep Newton's method from going on."""
DISTANCE_AIM_M, DISTANCE_ACCEPTED_M = 1e-9, 1e-8
"""The same for the distance of loaded nodes from the object, and of others inside it."""
_STEPS, _PATIENCE = 60, 10
"""Steps of Newton's method for one pose, and how many may pass without halving what is missed."""
_SHORTEST = 0.02
"""Step of the object over the reach of its surface below which moving it in is given up."""
_FINE_M = 1e-6
"""Motion below which steps are taken whole: facets of the object are rougher than that, and energy
and penetration do not say how good so small a step is."""
_SHORT = 0.05
"""Motion over the reach of the object's surface that is short."""
_FLATTEST = 1e-4
"""Share of the slope by which the energy must fall for a step to be taken (Armijo)."""


@dataclass(frozen=True)
class RubberContact(Contact):
    """Equilibrium of the exact membrane with an object, and how well it holds.

    Attributes
    ----------
    energy_j : float
        Stored in membrane and gas over the reference configuration: the work of the object.
    rim_force_n : (3,) array
        Of the rim on the membrane, N.
    gas_force_n : (3,) array
        Of the gas on it: gauge pressure times the area vector of the rim's opening, N.
    rest_force_n : (3,) array
        Resultant of f_rest, which stands in for what the reference surface lacks of equilibrium, N.
    stable : bool
        The energy is at a minimum.
    """

    energy_j: float
    rim_force_n: np.ndarray
    gas_force_n: np.ndarray
    rest_force_n: np.ndarray
    stable: bool

    @property
    def force_balance_n(self) -> float:
        """What contact, rim, gas and f_rest leave of each other, N."""
        held = self.rim_force_n + self.gas_force_n + self.rest_force_n
        return float(np.linalg.norm(self.nodal_force_n.sum(axis=0) + held))


@dataclass(frozen=True)
class _State:
    """A place on the way to equilibrium.

    Attributes
    ----------
    x : (n, 3) array
        Nodes, m.
    load : (n,) array
        Contact force along the object's normal, N.
    planes : Planes
        The object's, at x.
    """

    x: np.ndarray
    load: np.ndarray
    planes: Planes


@dataclass(frozen=True)
class _Missed:
    """By how much a state misses equilibrium.

    Attributes
    ----------
    balance : float
        Largest force left at a node over the largest load on one.
    distance_m : float
        Largest distance of loaded nodes from the object, and of others inside it.
    """

    balance: float
    distance_m: float

    @property
    def size(self) -> float:
        """Both over what is aimed at."""
        return max(self.balance / BALANCE_AIM, self.distance_m / DISTANCE_AIM_M)

    @property
    def accepted(self) -> bool:
        """Whether it is near enough."""
        return self.balance < BALANCE_ACCEPTED and self.distance_m < DISTANCE_ACCEPTED_M


@dataclass(frozen=True)
class _Solved:
    state: _State
    missed: _Missed
    stable: bool
    factorisations: int

    @property
    def accepted(self) -> bool:
        return self.missed.accepted and self.stable


@dataclass(frozen=True)
class PressStart:
    """A place near an equilibrium.

    Attributes
    ----------
    displacement_3d_m : (n, 3) array
    contact_pressure_pa : (n,) array
    """

    displacement_3d_m: np.ndarray
    contact_pressure_pa: np.ndarray


class RubberForward:
    """Presses rigid objects into one exact membrane.

    Minimises the energy of membrane and gas over positions with no node inside the object:
    sequential quadratic programmes with the half-spaces of its surface nearest to the nodes, and a
    line search on the energy, in which penetration has a price. On a curved object corners keep as
    far away as flat triangles would cut into it. It starts from the linear model's
    equilibrium, and where that fails moves the object in from outside in steps. What it finds does
    not depend on the poses before.

    Parameters
    ----------
    membrane : RubberMembrane
    gas : Gas
        P0 and V0 of the reference configuration.
    rounding_m : float, optional
        Radius that sharp edges of the objects are given, m.
    """

    def __init__(self, membrane: RubberMembrane, gas: Gas, rounding_m: float = 0.0) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self._rounding_m = rounding_m
        pattern = membrane.tangent(self.mesh.nodes, 0.0)
        self._factoriser, self._blocks = Factoriser(pattern), NodeBlocks(pattern)
        self._linear = ForwardModel(self.mesh, membrane.mean_tension, gas)
        self._rest_volume = membrane.volume(self.mesh.nodes)
        self._rest_energy = self._energy(self.mesh.nodes)
        self._reach = 2.0 * self.mesh.edge_length
        self._surface: ObjectSurface | None = None

    def press(
        self,
        obj: RigidObject,
        T_B_O: np.ndarray,
        near: PressStart | None = None,
        *,
        quick: bool = False,
    ) -> RubberContact:
        """Equilibrium with the object at the pose.

        Parameters
        ----------
        obj : RigidObject
        T_B_O : (4, 4) array
        near : PressStart, optional
            Where to look first.
        quick : bool, optional
            Be content with what is found from there and from the linear model's equilibrium, even
            if it has not converged.

        Raises
        ------
        InputError
            The pose is no rigid transform in metres.
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
        lowest = float((surface.object.vertices @ pose[2, :3]).min() + pose[2, 3])
        way = max(float(self.mesh.nodes[:, 2].max()) - lowest, 0.0)
        x, load = self.mesh.nodes, np.zeros(len(self.mesh.nodes))
        step, count = self._reach, 0
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
            if way == 0.0 or step < _SHORTEST * self._reach:
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
            newton = self._contact_step(state)
            step = newton.solve(state.load[moving] > 0.0)
            count += newton.factorisations
            if np.abs(step.motion).max() > self._reach:  # far off, loads turn too far
                newton = self._contact_step(state, turning=False)
                step = newton.solve(state.load[moving] > 0.0)
                count += newton.factorisations
            price = max(price, 2.0 * float(step.load.max(initial=0.0)))
            state = self._along(surface, pose, state, step, newton.residual, price, missed)
        if least.accepted and count:
            stable = newton.is_minimum()
        return _Solved(best, least, stable, count)

    def _contact_step(self, state: _State, *, turning: bool = True) -> ContactStep:
        membrane, moving = self.membrane, self.membrane.moving
        pressure, stiffness = self._gas_at(state.x)
        planes, load = state.planes.of(moving), state.load[moving]
        touching = np.flatnonzero(load > 0.0)
        data = membrane.tangent(state.x, pressure).data
        if turning:
            turn = -load[touching, None, None] * planes.turn[touching]
            data = self._blocks.added(data, touching, turn)
        return ContactStep(
            self._factoriser,
            self._blocks,
            data,
            membrane.residual(state.x, pressure)[moving],
            membrane.volume_gradient(state.x)[moving],
            stiffness,
            planes,
        )

    @cached_property
    def _rest_is_stable(self) -> bool:
        rest = self.mesh.nodes
        nothing = _State(rest, np.zeros(len(rest)), Planes.nowhere(len(rest)))
        return self._contact_step(nothing).is_minimum()

    def _along(
        self,
        surface: ObjectSurface,
        pose: np.ndarray,
        state: _State,
        step: Step,
        residual: np.ndarray,
        price: float,
        missed: _Missed,
    ) -> _State:
        """State as far along a step as energy and penetration fall together.

        Steps that are short for the mesh are taken whole where they come nearer to equilibrium.
        """
        moving = self.membrane.moving
        motion, load = np.zeros_like(state.x), np.zeros_like(state.load)
        motion[moving], load[moving] = step.motion, step.load
        inside = self._inside(state.planes)
        slope = float(np.sum(residual * step.motion)) - price * inside
        now = self._energy(state.x) + price * inside
        noise = 1e-13 * abs(now)
        most = max(float(np.abs(motion).max()), 1e-300)
        length = min(1.0, self._reach / most)

        def at(x: np.ndarray) -> tuple[_State, bool]:
            ahead = self._at(surface, pose, x, state.load + length * (load - state.load))
            value = self._energy(x) + price * self._inside(ahead.planes)
            return ahead, value <= now + _FLATTEST * length * slope + noise

        if most < _SHORT * self._reach:
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
        outward = self.membrane.volume_gradient(x)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        planes = surface.planes(x, outward, pose, self._reach)
        gap = planes.gap - self._sag(x, planes)
        return _State(x, load, planes._replace(gap=gap))

    def _sag(self, x: np.ndarray, planes: Planes) -> np.ndarray:
        """How far flat triangles with their corners on the object are inside it, (n,), m.

        Their mean depth is Σ (n_j − n_i)·(x_j − x_i)/24 over the edges; corners are kept as far
        out, so that the surface and not its corners lies on the object.
        """
        triangles = self.mesh.triangles
        some = np.flatnonzero(np.isfinite(planes.gap)[triangles].all(axis=1))
        corners, normals = x[triangles[some]], planes.normal[triangles[some]]
        turn, edge = (np.roll(v, -1, axis=1) - v for v in (normals, corners))
        depth = np.einsum("tij,tij->t", turn, edge) / 24.0
        sharpness = np.linalg.norm(turn, axis=2).max(axis=1) / MOST_TURN_RAD
        depth *= np.maximum(1.0 - sharpness**4, 0.0)
        at, count = triangles[some].ravel(), np.zeros(len(x))
        np.add.at(count, at, 1.0)
        return np.bincount(at, np.repeat(depth, 3), len(x)) / np.maximum(count, 1.0)

    def _inside(self, planes: Planes) -> float:
        """Sum of the depths of the moving nodes in the object, m."""
        return float(np.maximum(-planes.gap[self.membrane.moving], 0.0).sum())

    def _gas_at(self, x: np.ndarray) -> tuple[float, float]:
        """Gauge pressure, Pa, and −dp/dV, Pa/m³; inf where no volume is left."""
        volume = self.gas.V0 + self.membrane.volume(x) - self._rest_volume
        if not volume > 0.0:
            return np.inf, np.inf
        pressure = self.gas.P0 * self.gas.V0 / volume
        return pressure - self.gas.P0 + self.membrane.gauge_pressure_pa, pressure / volume

    def _energy(self, x: np.ndarray) -> float:
        """Energy of membrane and gas, J, up to a constant; its gradient is the residual."""
        P0, V0 = self.gas.P0, self.gas.V0
        volume = V0 + self.membrane.volume(x) - self._rest_volume
        if not volume > 0.0:
            return np.inf
        outside = P0 - self.membrane.gauge_pressure_pa
        gas = outside * volume - P0 * V0 * np.log(volume / V0)
        rest = np.sum(self.membrane.rest_force[self.membrane.moving] * x[self.membrane.moving])
        return self.membrane.energy(x) + gas - float(rest)

    def _missed(self, state: _State) -> _Missed:
        pressure, _ = self._gas_at(state.x)
        if not np.isfinite(pressure):
            return _Missed(np.inf, np.inf)
        moving = self.membrane.moving
        push = state.load[moving, None] * state.planes.normal[moving]
        left = self.membrane.residual(state.x, pressure)[moving] - push
        gas = abs(pressure) * float(self.mesh.areas.max())
        gap = state.planes.gap[moving]
        away = np.where(state.load[moving] > 0.0, np.abs(gap), np.maximum(-gap, 0.0))
        scale = max(gas, float(state.load.max()))
        return _Missed(float(np.abs(left).max()) / scale, float(away.max()))

    def _certified(self, solved: _Solved, linear: Contact) -> RubberContact:
        state, membrane, mesh = solved.state, self.membrane, self.mesh
        pressure, _ = self._gas_at(state.x)
        displacement = state.x - mesh.nodes
        force = state.load[:, None] * state.planes.normal
        areas = replace(mesh, nodes=state.x).areas
        from_gas = pressure * membrane.volume_gradient(state.x)
        rim, moving = mesh.rim, np.isin(np.arange(len(mesh.nodes)), membrane.moving)
        held = membrane.force(state.x) - from_gas
        sprung = membrane.rim_springs[:, None] * displacement
        contact_pressure = state.load / areas
        gap = np.where(np.isfinite(state.planes.gap), state.planes.gap, 0.0)
        return RubberContact(
            displacement_m=np.einsum("ij,ij->i", displacement, mesh.normals),
            displacement_3d_m=displacement,
            contact_pressure_pa=contact_pressure,
            nodal_force_n=force,
            gap_m=state.planes.gap,
            gas_pressure_change_pa=pressure - membrane.gauge_pressure_pa,
            complementarity=float(np.abs(gap * contact_pressure).max()),
            penetration_m=float(-gap[moving].min(initial=0.0)),
            rim_penetration_m=linear.rim_penetration_m,
            balance_residual=solved.missed.balance,
            gas_law_residual=0.0,
            iterations=solved.factorisations,
            outer_iterations=1,
            converged=solved.accepted,
            energy_j=self._energy(state.x) - self._rest_energy,
            rim_force_n=np.where(moving[:, None], -sprung, held)[rim].sum(axis=0),
            gas_force_n=from_gas.sum(axis=0),
            rest_force_n=membrane.rest_force[moving].sum(axis=0),
            stable=solved.stable,
        )
