"""Rigid objects pressed into the exact membrane, without friction, against the gas behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bubbleviz.membrane.contact_step import ContactStep, Friction, Step
from bubbleviz.membrane.forward_model import Contact, ForwardModel, checked_pose
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.object_surface import MOST_TURN_RAD, ObjectSurface, Planes
from bubbleviz.membrane.rubber import RubberMembrane
from bubbleviz.membrane.sparse_factor import Factoriser, NodeBlocks
from bubbleviz.rigid_object import RigidObject

# An exact membrane with the gas behind it and what touches it: energy, loads, certificates.


BALANCE_AIM, BALANCE_ACCEPTED = 1e-7, 1e-6
"""Largest force left at a node over the largest load on one: what is aimed at, and what will do
where facets of the object keep Newton's method from going on."""
DISTANCE_AIM_M, DISTANCE_ACCEPTED_M = 1e-9, 1e-8
"""The same for the distance of loaded nodes from the object, and of others inside it."""


@dataclass(frozen=True)
class RubberContact(Contact):
    """Equilibrium of the exact membrane with an object, and how well it holds."""

    # stored in membrane and gas over the reference configuration: the work of the object, less what
    # friction has dissipated
    energy_j: float
    rim_force_n: np.ndarray  # (3,), of the rim on the membrane, N
    # (3,), of the gas on it: gauge pressure times the area vector of the rim's opening, N
    gas_force_n: np.ndarray
    # (3,), resultant of f_rest, which stands in for what the reference surface lacks of
    # equilibrium, N
    rest_force_n: np.ndarray
    stable: bool  # the energy is at a minimum

    @property
    def force_balance_n(self) -> float:
        """What contact, rim, gas and f_rest leave of each other, N."""
        held = self.rim_force_n + self.gas_force_n + self.rest_force_n
        return float(np.linalg.norm(self.nodal_force_n.sum(axis=0) + held))


@dataclass(frozen=True)
class Missed:
    """By how much a state misses equilibrium."""

    balance: float  # largest force left at a node over the largest load on one
    distance_m: float  # largest distance of loaded nodes from the object, and of others inside it

    @property
    def size(self) -> float:
        """Both over what is aimed at."""
        return max(self.balance / BALANCE_AIM, self.distance_m / DISTANCE_AIM_M)

    @property
    def accepted(self) -> bool:
        """Whether it is near enough."""
        return self.balance < BALANCE_ACCEPTED and self.distance_m < DISTANCE_ACCEPTED_M


class RubberAndGas:
    """A membrane and its gas.

    Attributes
    ----------
    reach_m : float
        Nodes further from an object than this do not know of it.
    """

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas,  # P0 and V0 of the reference configuration
    ) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self.reach_m = 2.0 * self.mesh.edge_length
        self._rest_volume = membrane.volume(self.mesh.nodes)
        self._rest_energy = self.energy(self.mesh.nodes)
        rest = membrane.tangent(self.mesh.nodes, 0.0)
        self._factoriser, self._blocks = Factoriser(rest), NodeBlocks(rest)
        self.weight = float(np.abs(rest.diagonal()).mean())  # stiffness of a node, N/m

    def step(
        self,
        x: np.ndarray,  # (n, 3), nodes, m
        load: np.ndarray,  # (n,), along the normals of the planes, N
        planes: Planes,
        law: Friction | None = None,  # there, at all nodes
        *,
        turning: bool = True,  # loads turn with the object's surface
    ) -> ContactStep:
        """Newton's step from a place."""
        membrane, moving = self.membrane, self.membrane.moving
        (pressure, beta), planes, load = self.gas_at(x), planes.of(moving), load[moving]
        residual, grip = membrane.residual(x, pressure), None
        data = membrane.tangent(x, pressure).data
        touching = np.flatnonzero(load > 0.0)
        if turning:
            blocks = -load[touching, None, None] * planes.turn[touching]
            if law is not None:
                blocks += law.stiffness[moving[touching]]
                residual, grip = residual + law.start, law.grip.of(moving)
            data = self._blocks.added(data, touching, blocks)
        gradient = membrane.volume_gradient(x)[moving]
        own = self._factoriser, self._blocks, data
        return ContactStep(*own, residual[moving], gradient, beta, planes, grip)

    def clear_of(self, surface: ObjectSurface, pose: np.ndarray) -> float:
        """Way along z by which an object is above the membrane at rest, at least 0, m."""
        lowest = float((surface.object.vertices @ pose[2, :3]).min() + pose[2, 3])
        return max(float(self.mesh.nodes[:, 2].max()) - lowest, 0.0)

    def planes(self, surface: ObjectSurface, pose: np.ndarray, x: np.ndarray) -> Planes:
        """Conditions that an object at a pose sets the nodes at x (n, 3)."""
        outward = self.membrane.volume_gradient(x)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        planes = surface.planes(x, outward, pose, self.reach_m)
        return planes._replace(gap=planes.gap - self._sag(x, planes))

    def gas_at(self, x: np.ndarray) -> tuple[float, float]:
        """Gauge pressure, Pa, and −dp/dV, Pa/m³; inf where no volume is left."""
        volume = self.gas.V0 + self.membrane.volume(x) - self._rest_volume
        if not volume > 0.0:
            return np.inf, np.inf
        pressure = self.gas.P0 * self.gas.V0 / volume
        return pressure - self.gas.P0 + self.membrane.gauge_pressure_pa, pressure / volume

    def energy(self, x: np.ndarray) -> float:
        """Energy of membrane and gas, J, up to a constant; its gradient is the residual."""
        P0, V0 = self.gas.P0, self.gas.V0
        volume = V0 + self.membrane.volume(x) - self._rest_volume
        if not volume > 0.0:
            return np.inf
        outside = P0 - self.membrane.gauge_pressure_pa
        gas = outside * volume - P0 * V0 * np.log(volume / V0)
        rest = np.sum(self.membrane.rest_force[self.membrane.moving] * x[self.membrane.moving])
        return self.membrane.energy(x) + gas - float(rest)

    def missed(
        self,
        x: np.ndarray,  # (n, 3)
        load: np.ndarray,  # (n,), along the normals of the planes, N
        planes: Planes,
        across: np.ndarray | None = None,  # (n, 3), the forces across the normals, N
        off_n: float = 0.0,  # by how much their law is missed, N
    ) -> Missed:
        """How far nodes at x (n, 3) are from equilibrium under contact forces."""
        pressure, _ = self.gas_at(x)
        if not np.isfinite(pressure):
            return Missed(np.inf, np.inf)
        moving = self.membrane.moving
        push = load[moving, None] * planes.normal[moving]
        if across is not None:
            push += across[moving]
        left = self.membrane.residual(x, pressure)[moving] - push
        gas = abs(pressure) * float(self.mesh.areas.max())
        gap = planes.gap[moving]
        away = np.where(load[moving] > 0.0, np.abs(gap), np.maximum(-gap, 0.0))
        scale = max(gas, float(load.max()))
        return Missed(max(float(np.abs(left).max()), off_n) / scale, float(away.max()))

    def contact(
        self,
        x: np.ndarray,
        load: np.ndarray,
        planes: Planes,
        *,
        nodal_force_n: np.ndarray,
        rim_penetration_m: float,
        missed: Missed,
        factorisations: int,
        converged: bool,
        stable: bool,
    ) -> RubberContact:
        """The contact with nodes at x (n, 3) and loads (n,) along the normals."""
        membrane, mesh = self.membrane, self.mesh
        pressure, _ = self.gas_at(x)
        displacement = x - mesh.nodes
        areas = replace(mesh, nodes=x).areas
        from_gas = pressure * membrane.volume_gradient(x)
        rim, moving = mesh.rim, np.isin(np.arange(len(mesh.nodes)), membrane.moving)
        held = membrane.force(x) - from_gas
        sprung = membrane.rim_springs[:, None] * displacement
        contact_pressure = load / areas
        gap = np.where(np.isfinite(planes.gap), planes.gap, 0.0)
        return RubberContact(
            displacement_m=np.einsum("ij,ij->i", displacement, mesh.normals),
            displacement_3d_m=displacement,
            contact_pressure_pa=contact_pressure,
            nodal_force_n=nodal_force_n,
            gap_m=planes.gap,
            gas_pressure_change_pa=pressure - membrane.gauge_pressure_pa,
            complementarity=float(np.abs(gap * contact_pressure).max()),
            penetration_m=float(-gap[moving].min(initial=0.0)),
            rim_penetration_m=rim_penetration_m,
            balance_residual=missed.balance,
            gas_law_residual=0.0,
            iterations=factorisations,
            outer_iterations=1,
            converged=converged,
            energy_j=self.energy(x) - self._rest_energy,
            rim_force_n=np.where(moving[:, None], -sprung, held)[rim].sum(axis=0),
            gas_force_n=from_gas.sum(axis=0),
            rest_force_n=membrane.rest_force[moving].sum(axis=0),
            stable=stable,
        )

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
