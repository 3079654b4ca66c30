"""Equilibrium of the exact membrane with the gas behind it and a rigid object, by Newton's method.

Without friction the energy of membrane and gas is least over positions with no node inside the
object: sequential quadratic programmes with the half-spaces of its surface nearest to the nodes,
and a line search on the energy, in which penetration has a price. With friction there is no such
energy: Coulomb's law is implicit (backward Euler), and steps are shortened where whole ones come no
nearer. On a curved object corners keep as far away as flat triangles would cut into it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.membrane.contact_step import ContactStep, Friction, Step
from bubbleviz.membrane.forward_model import Contact
from bubbleviz.membrane.gas import Gas, HeldPressure
from bubbleviz.membrane.object_surface import MOST_TURN_RAD, ObjectSurface, Planes
from bubbleviz.membrane.rubber import RubberMembrane
from bubbleviz.membrane.sparse_factor import Factor, Factoriser, NodeBlocks

BALANCE_AIM, BALANCE_ACCEPTED = 1e-7, 1e-6
"""Largest force left at a node over the largest load on one: what is aimed at, and what will do
where facets of the object keep Newton's method from going on."""
DISTANCE_AIM_M, DISTANCE_ACCEPTED_M = 1e-9, 1e-8
"""The same for the distance of loaded nodes from the object, and of others inside it."""
_STEPS, _PATIENCE = 60, 10
"""Steps of Newton's method, and how many may pass without halving what is missed."""
_SHARES = (0.5, 0.25, 0.1)  # of a step with friction, tried where whole ones come no nearer
_FINE_M = 1e-6
"""Motion below which steps are taken whole: facets of the object are rougher than that, and energy
and penetration do not say how good so small a step is."""
_SHORT = 0.05  # motion over the reach of the object's surface that is short
_FLATTEST = 1e-4  # share of the slope by which the energy must fall for a step to be taken (Armijo)


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
    stable: bool  # the energy is at a minimum; with friction: no pivot of the tangent is negative
    # (n,), way that each touching node slipped over the object since the contact before, m, 0 where
    # nothing touches; NaN without friction
    slip_m: np.ndarray
    stick_error_m: float = 0.0  # largest distance of a sticking node from its anchor, m
    # largest |t| of a node over μ times its load, less 1; 0 where none is above
    cone_violation: float = 0.0
    dissipated_j: float = 0.0  # work lost to slip since the contact before, J

    @property
    def force_balance_n(self) -> float:
        """What contact, rim, gas and f_rest leave of each other, N."""
        held = self.rim_force_n + self.gas_force_n + self.rest_force_n
        return float(np.linalg.norm(self.nodal_force_n.sum(axis=0) + held))


@dataclass(frozen=True)
class State:
    """Where membrane and object are, and what is between them."""

    x: np.ndarray  # (n, 3), nodes, m
    load: np.ndarray  # (n,), contact force along the object's normal, N
    pose: np.ndarray  # (4, 4), T_B_O
    pull: np.ndarray  # (n, 3), of the nodes on the object across its normal, N
    anchors: np.ndarray  # (n, 3), places on the object, in O, m; NaN for nodes that do not stick

    @classmethod
    def free(cls, x: np.ndarray, load: np.ndarray, pose: np.ndarray) -> State:
        """Without friction so far."""
        return cls(x, load, pose, np.zeros_like(x), np.full(x.shape, np.nan))

    def away(self) -> np.ndarray:
        """From the anchors to the nodes, (n, 3), m."""
        away: np.ndarray = self.x - (self.anchors @ self.pose[:3, :3].T + self.pose[:3, 3])
        return away


@dataclass(frozen=True)
class Looked:
    """A state, what the object asks of it, and by how much it misses equilibrium."""

    state: State
    planes: Planes  # the object's
    law: Friction | None
    balance: float  # largest force left at a node over the largest load on one
    distance_m: float  # largest distance of loaded nodes from the object, and of others inside it

    @property
    def residual_ratio(self) -> float:
        """The larger of both, relative to its aim."""
        return max(self.balance / BALANCE_AIM, self.distance_m / DISTANCE_AIM_M)

    @property
    def accepted(self) -> bool:
        """Whether both are below the accepted limits."""
        return self.balance < BALANCE_ACCEPTED and self.distance_m < DISTANCE_ACCEPTED_M


@dataclass(frozen=True)
class Solved:
    """What Newton's method ended at."""

    at: Looked
    stable: bool
    factorisations: int

    @property
    def accepted(self) -> bool:
        """Whether it is an equilibrium."""
        return self.at.accepted and self.stable


class Equilibrium:
    """A membrane and its gas, at one pose of an object or without.

    Attributes
    ----------
    reach_m : float
        Nodes further from an object than this do not know of it.
    """

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas | HeldPressure,  # of the reference configuration
        # (n, 3), forces f_rest at the nodes beside the gas's: those that hold the reference surface
        # where not given, 0 for a membrane whose mesh is not the equilibrium
        rest_force_n: np.ndarray | None = None,
    ) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self.friction = 0.0  # Coulomb's μ
        self._rest_force = membrane.rest_force if rest_force_n is None else rest_force_n
        self.reach_m = 2.0 * self.mesh.edge_length
        self._rest_volume = membrane.volume(self.mesh.nodes)
        rest = membrane.tangent(self.mesh.nodes, 0.0)
        self._factoriser, self._blocks = Factoriser(rest), NodeBlocks(rest)
        self._weight = float(np.abs(rest.diagonal()).mean())  # stiffness of a node, N/m

    def varied(self, **changes: object) -> Equilibrium:
        """The same membrane with another `gas`, or `friction`."""
        other = copy(self)
        vars(other).update(changes)
        return other

    # -- membrane and gas -----------------------------------------------------------------------

    def gas_at(self, x: np.ndarray) -> tuple[float, float]:
        """Gauge pressure, Pa, and −dp/dV, Pa/m³; inf where no volume is left."""
        change, stiffness = self.gas.at(self.membrane.volume(x) - self._rest_volume)
        return change + self.membrane.gauge_pressure_pa, stiffness

    def energy(self, x: np.ndarray) -> float:
        """Energy of membrane and gas, J, up to a constant; its gradient is the residual."""
        membrane, moving = self.membrane, self.membrane.moving
        growth = membrane.volume(x) - self._rest_volume
        rest = np.sum(self._rest_force[moving] * x[moving])
        gas = self.gas.energy(growth) - membrane.gauge_pressure_pa * growth
        return membrane.energy(x) + gas - float(rest)

    def factor(self, x: np.ndarray) -> Factor:
        """Factorised tangent of the membrane under the gas's pressure, without the gas law."""
        return self._factoriser.factor(self.membrane.tangent(x, self.gas_at(x)[0]).data)

    def _residual(self, x: np.ndarray, pressure: float) -> np.ndarray:
        """External force needed for equilibrium, (n, 3), N."""
        left = self.membrane.residual(x, pressure)
        if self._rest_force is not self.membrane.rest_force:
            left += self.membrane.rest_force - self._rest_force
        return left

    # -- states ---------------------------------------------------------------------------------

    def look(self, surface: ObjectSurface | None, state: State) -> Looked:
        """What an object asks of a state, and what that misses of equilibrium."""
        x, moving = state.x, self.membrane.moving
        planes, law, off = self._planes(surface, state), None, 0.0
        push, away = state.load[:, None] * planes.normal, 0.0
        if self.friction:
            law = Friction.at(
                state.away(), state.pull, state.load, planes, self.friction, self._weight
            )
            off = float(np.abs(law.pull - state.pull).max())
            away = float(np.linalg.norm(law.grip.back, axis=1).max())
            push -= law.pull
        pressure, _ = self.gas_at(x)
        if not np.isfinite(pressure):
            return Looked(state, planes, law, np.inf, np.inf)
        left = (self._residual(x, pressure) - push)[moving]
        scale = max(abs(pressure) * float(self.mesh.areas.max()), float(state.load[moving].max()))
        gap = planes.gap[moving]
        inside = np.where(state.load[moving] > 0.0, np.abs(gap), np.maximum(-gap, 0.0))
        balance = max(float(np.abs(left).max()), off) / scale
        return Looked(state, planes, law, balance, max(float(inside.max()), away))

    def clear_of(self, surface: ObjectSurface, pose: np.ndarray) -> float:
        """Way along z by which an object is above the membrane at rest, at least 0, m."""
        lowest = float((surface.obj.vertices @ pose[2, :3]).min() + pose[2, 3])
        return max(float(self.mesh.nodes[:, 2].max()) - lowest, 0.0)

    def _planes(self, surface: ObjectSurface | None, state: State) -> Planes:
        if surface is None:
            return Planes.nowhere(len(state.x))
        outward = self.membrane.volume_gradient(state.x)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        planes = surface.planes(state.x, outward, state.pose, self.reach_m)
        return planes._replace(gap=planes.gap - self._sag(state.x, planes))

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

    # -- Newton's method ------------------------------------------------------------------------

    def solve(self, surface: ObjectSurface | None, start: State) -> Solved:
        """Newton's method from a state, at its pose: the best of the states on the way."""
        here = best = self.look(surface, start)
        price, since, count, newton = 0.0, 0, 0, None
        for _ in range(_STEPS):
            nearer = newton is None or here.residual_ratio < 0.5 * best.residual_ratio
            since = 0 if nearer else since + 1
            best = min(best, here, key=lambda each: each.residual_ratio)
            if best.residual_ratio < 1.0 or (best.accepted and since > 1) or since > _PATIENCE:
                break
            newton, held = self._step(here), here.state.load[self.membrane.moving] > 0.0
            if self.friction:
                try:
                    step = newton.direct(held)
                except RuntimeError:  # singular
                    break
                ahead = self._nearer(surface, here, step, often=since > 0)
                if not np.isfinite(ahead.residual_ratio):
                    break
            else:
                step = newton.solve(held)
                if np.abs(step.motion).max() > self.reach_m:  # far off, loads turn too far
                    count += newton.factorisations
                    newton = self._step(here, turning=False)
                    step = newton.solve(held)
                price = max(price, 2.0 * float(step.load.max(initial=0.0)))
                ahead = self._downhill(surface, here, step, newton.residual, price)
            count, here = count + newton.factorisations, ahead
            if surface is None and not newton.is_minimum():
                break
        stable = not best.accepted or (newton or self._step(best)).is_minimum()
        return Solved(best, stable, count)

    def _step(self, looked: Looked, *, turning: bool = True) -> ContactStep:
        """Newton's step; `turning`: loads turn with the object's surface."""
        membrane, moving, state = self.membrane, self.membrane.moving, looked.state
        (pressure, beta), load = self.gas_at(state.x), state.load[moving]
        planes, law, grip = looked.planes.of(moving), looked.law, None
        residual = self._residual(state.x, pressure)
        data = membrane.tangent(state.x, pressure).data
        touching = np.flatnonzero(load > 0.0)
        if turning:
            blocks = -load[touching, None, None] * planes.turn[touching]
            if law is not None:
                blocks += law.stiffness[moving[touching]]
                residual, grip = residual + law.start, law.grip.of(moving)
            data = self._blocks.added(data, touching, blocks)
        gradient = membrane.volume_gradient(state.x)[moving]
        own = self._factoriser, self._blocks, data
        return ContactStep(*own, residual[moving], gradient, beta, planes, grip)

    def _after(self, looked: Looked, step: Step, length: float) -> State:
        """The state after a share of a step."""
        state, law, moving = looked.state, looked.law, self.membrane.moving
        x, load, pull = state.x.copy(), state.load.copy(), state.pull
        x[moving] += length * step.motion
        load[moving] += length * (step.load - load[moving])
        if law is not None:
            pull, grip, held = pull.copy(), law.grip.of(moving), step.held[:, None]
            turned = np.einsum("kij,kj->ki", law.stiffness[moving], step.motion)
            turned += law.start[moving]
            slips = held & grip.drag.any(axis=1, keepdims=True)
            aim = np.where(slips, step.load[:, None] * grip.drag + turned, 0.0)
            across = step.load[:, None] * looked.planes.normal[moving] - step.pull
            aim = np.where(held & grip.stuck[:, None], across, aim)
            pull[moving] += length * (aim - pull[moving])
        return replace(state, x=x, load=load, pull=pull)

    def _nearer(
        self, surface: ObjectSurface | None, here: Looked, step: Step, *, often: bool
    ) -> Looked:
        """State along a step with friction: the nearest to equilibrium of some, if need be."""
        longest = max(float(np.abs(step.motion).max()), 1e-300)

        def at(share: float) -> Looked:
            return self.look(surface, self._after(here, step, min(share, self.reach_m / longest)))

        ahead = at(1.0)
        if often or not np.isfinite(ahead.residual_ratio):  # round in circles, or too far
            ahead = min([ahead, *map(at, _SHARES)], key=lambda each: each.residual_ratio)
        return ahead

    def _downhill(
        self,
        surface: ObjectSurface | None,
        here: Looked,
        step: Step,
        residual: np.ndarray,
        price: float,
    ) -> Looked:
        """State as far along a step as energy and penetration fall together.

        Steps that are short for the mesh are taken whole where they come nearer to equilibrium.
        """
        inside = self._inside(here)
        slope = float(np.sum(residual * step.motion)) - price * inside
        now = self.energy(here.state.x) + price * inside
        most = max(float(np.abs(step.motion).max()), 1e-300)
        length = min(1.0, self.reach_m / most)
        wanted = now + 1e-13 * abs(now)

        def at(state: State, length: float) -> tuple[Looked, bool]:
            ahead = self.look(surface, state)
            value = self.energy(state.x) + price * self._inside(ahead)
            return ahead, value <= wanted + _FLATTEST * length * slope

        if most < _SHORT * self.reach_m:
            ahead, falls = at(self._after(here, step, 1.0), 1.0)
            if falls or ahead.residual_ratio < 0.5 * here.residual_ratio:
                return ahead
        while True:
            ahead, falls = at(self._after(here, step, length), length)
            if not falls and step.held.any():
                ahead, falls = at(self._put_back(ahead, here, step.held, length), length)
            if falls or length < 1e-4 or most < _FINE_M:
                return ahead
            length *= 0.5

    def _put_back(self, ahead: Looked, here: Looked, held: np.ndarray, length: float) -> State:
        """The state with the `held` nodes as far from the object as its planes would have them.

        A long step along a curved surface leaves it to second order, which would shorten the step
        again and again near the solution (Maratos).
        """
        nodes = self.membrane.moving[held]
        gap, normal, _ = ahead.planes.of(nodes)
        off = gap - (1.0 - length) * here.planes.gap[nodes]
        x = ahead.state.x.copy()
        x[nodes] -= np.where(np.isfinite(off), off, 0.0)[:, None] * normal
        return replace(ahead.state, x=x)

    def _inside(self, looked: Looked) -> float:
        """Sum of the depths of the moving nodes in the object, m."""
        return float(np.maximum(-looked.planes.gap[self.membrane.moving], 0.0).sum())

    # -- what it tells --------------------------------------------------------------------------

    def contact(self, solved: Solved, rim_penetration_m: float | None = None) -> RubberContact:
        """The contact at what was solved."""
        membrane, mesh, looked = self.membrane, self.mesh, solved.at
        state, planes, law = looked.state, looked.planes, looked.law
        x, load = state.x, state.load
        pressure, _ = self.gas_at(x)
        displacement = x - mesh.nodes
        from_gas = pressure * membrane.volume_gradient(x)
        moving = np.isin(np.arange(len(x)), membrane.moving)
        held = membrane.force(x) - from_gas
        sprung = membrane.rim_springs[:, None] * displacement
        contact_pressure = load / replace(mesh, nodes=x).areas
        gap = np.where(np.isfinite(planes.gap), planes.gap, 0.0)
        if rim_penetration_m is None:
            rim_penetration_m = float(-gap[~moving].min(initial=0.0))
        force, off, over = load[:, None] * planes.normal, 0.0, np.zeros(0)
        if law is not None:
            force -= law.pull
            off = float(np.linalg.norm(law.grip.back, axis=1).max())
            over = np.linalg.norm(law.pull, axis=1)[load > 0.0] / (self.friction * load[load > 0.0])
        return RubberContact(
            displacement_m=np.einsum("ij,ij->i", displacement, mesh.normals),
            displacement_3d_m=displacement,
            contact_pressure_pa=contact_pressure,
            nodal_force_n=force,
            gap_m=planes.gap,
            gas_pressure_change_pa=pressure - membrane.gauge_pressure_pa,
            complementarity=float(np.abs(gap * contact_pressure).max()),
            penetration_m=float(-gap[moving].min(initial=0.0)),
            rim_penetration_m=rim_penetration_m,
            balance_residual=looked.balance,
            gas_law_residual=0.0,
            iterations=solved.factorisations,
            converged=solved.accepted,
            energy_j=self.energy(x) - self.energy(mesh.nodes),
            rim_force_n=np.where(moving[:, None], -sprung, held)[mesh.rim].sum(axis=0),
            gas_force_n=from_gas.sum(axis=0),
            rest_force_n=membrane.rest_force[moving].sum(axis=0),
            stable=solved.stable,
            slip_m=np.full(len(x), np.nan),
            stick_error_m=off,
            cone_violation=float((over - 1.0).max(initial=0.0)),
        )
