"""Equilibrium of the exact membrane with the gas behind it and a rigid object, by Newton's method.

Without friction, equilibrium minimises the energy of membrane and gas over positions with no node
inside the object, by sequential quadratic programmes: each node is constrained to the half-space of
the nearest surface of the object, and a line search uses the energy with a penalty on penetration.
With friction there is no such energy: Coulomb's law is implicit (backward Euler), and steps that do
not reduce the residual are shortened. On a curved object, nodes keep a distance so that the flat
triangles between them do not cut into it.
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

BALANCE_AIM, BALANCE_ACCEPTED, BALANCE_ROUGH = 1e-7, 1e-6, 1e-3
"""Limits of the largest residual force at a node over the largest load on one: the aim; accepted if
facets of the object keep Newton's method from converging further; and accepted if, without
friction, it alternates between facets of fillets that are finer than the mesh. The last is a tenth
of the error of the mesh itself."""
DISTANCE_AIM_M, DISTANCE_ACCEPTED_M, DISTANCE_ROUGH_M = 1e-9, 1e-8, 1e-6
"""The same for the distance of loaded nodes from the object, and of others inside it: facets are
rougher than the last."""
_STEPS, _PATIENCE = 60, 10
"""Steps of Newton's method, and how many may pass without halving the residual."""
_SHARES = (0.5, 0.25, 0.1)  # of a step with friction, tried until the residual decreases
_FINE_M = 1e-6
"""Motion below which steps are not shortened: facets of the object are rougher than that, so that
energy and penetration do not measure progress."""
_SHORT = 0.05  # short motion, over `reach_m`
_ARMIJO = 1e-4  # least decrease of the energy over that by its slope, for a step to be accepted


@dataclass(frozen=True)
class RubberContact(Contact):
    """Equilibrium of the exact membrane with an object, and how well it holds."""

    # stored in membrane and gas since the reference configuration: work of the object minus
    # dissipation by friction
    energy_j: float
    stable: bool  # the energy is at a minimum; with friction: no pivot of the tangent is negative
    # (n,), slip of each touching node over the object since the previous contact, m, 0 for other
    # nodes; NaN without friction
    slip_m: np.ndarray
    stick_error_m: float = 0.0  # largest distance of a sticking node from its anchor, m
    # largest |t| of a node over μ times its load, minus 1; 0 if none is above
    cone_violation: float = 0.0
    dissipated_j: float = 0.0  # by slip since the previous contact, J


@dataclass(frozen=True)
class State:
    """Positions of membrane and object, and the forces between them."""

    x: np.ndarray  # (n, 3), nodes, m
    load: np.ndarray  # (n,), contact force along the object's normal, N
    pose: np.ndarray  # (4, 4), T_B_O
    pull: np.ndarray  # (n, 3), of the nodes on the object across its normal, N
    anchors: np.ndarray  # (n, 3), points on the object, in O, m; NaN for nodes that do not stick

    @classmethod
    def free(cls, x: np.ndarray, load: np.ndarray, pose: np.ndarray) -> State:
        """State without friction."""
        return cls(x, load, pose, np.zeros_like(x), np.full(x.shape, np.nan))

    def from_anchors(self) -> np.ndarray:
        """Displacements of the nodes from their anchors, (n, 3), m."""
        moved: np.ndarray = self.x - (self.anchors @ self.pose[:3, :3].T + self.pose[:3, 3])
        return moved


@dataclass(frozen=True)
class Evaluated:
    """A state with its contact constraints and its residuals."""

    state: State
    planes: Planes  # the object's
    law: Friction | None
    balance: float  # largest residual force at a node over the largest load on one
    distance_m: float  # largest distance of loaded nodes from the object, and of others inside it

    @property
    def residual_ratio(self) -> float:
        """The larger of both, relative to its aim."""
        return max(self.balance / BALANCE_AIM, self.distance_m / DISTANCE_AIM_M)

    @property
    def accepted(self) -> bool:
        """Whether both are below the accepted limits."""
        return self.balance < BALANCE_ACCEPTED and self.distance_m < DISTANCE_ACCEPTED_M

    @property
    def is_equilibrium(self) -> bool:
        """Whether it is accepted, or within the limits for contact without friction on fillets."""
        rough = self.balance < BALANCE_ROUGH and self.distance_m < DISTANCE_ROUGH_M
        return self.accepted or (rough and self.law is None and bool(self.state.load.any()))


@dataclass(frozen=True)
class Solved:
    """Final state of Newton's method."""

    at: Evaluated
    stable: bool
    factorisations: int

    @property
    def accepted(self) -> bool:
        """Whether it is an equilibrium."""
        return self.at.is_equilibrium and self.stable


class Equilibrium:
    """A membrane and its gas, at one pose of an object or without.

    Attributes
    ----------
    reach_m : float
        Nodes further from an object than this are not constrained by it.
    """

    def __init__(
        self,
        membrane: RubberMembrane,
        gas: Gas | HeldPressure,  # of the reference configuration
    ) -> None:
        self.membrane, self.gas, self.mesh = membrane, gas, membrane.mesh
        self.friction = 0.0  # Coulomb's μ
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
        """Gauge pressure, Pa, and −dp/dV, Pa/m³; inf for a volume of 0 or less."""
        change, stiffness = self.gas.at(self.membrane.volume(x) - self._rest_volume)
        return change + self.membrane.gauge_pressure_pa, stiffness

    def energy(self, x: np.ndarray) -> float:
        """Energy of membrane and gas, J, up to a constant; its gradient is the residual."""
        membrane, moving = self.membrane, self.membrane.moving
        growth = membrane.volume(x) - self._rest_volume
        rest = np.sum(membrane.rest_force[moving] * x[moving])
        gas = self.gas.energy(growth) - membrane.gauge_pressure_pa * growth
        return membrane.energy(x) + gas - float(rest)

    def factor(self, x: np.ndarray) -> Factor:
        """Factorised tangent of the membrane under the gas's pressure, without the gas law."""
        return self._factoriser.factor(self.membrane.tangent(x, self.gas_at(x)[0]).data)

    # -- states ---------------------------------------------------------------------------------

    def evaluate(self, surface: ObjectSurface, state: State) -> Evaluated:
        """Contact constraints and residuals of a state."""
        x, moving = state.x, self.membrane.moving
        planes, law, off = self._planes(surface, state), None, 0.0
        push, stick_error = state.load[:, None] * planes.normal, 0.0
        if self.friction:
            law = Friction.at(
                state.from_anchors(), state.pull, state.load, planes, self.friction, self._weight
            )
            off = float(np.abs(law.pull - state.pull).max())
            stick_error = float(np.linalg.norm(law.grip.back, axis=1).max())
            push -= law.pull
        pressure, _ = self.gas_at(x)
        if not np.isfinite(pressure):
            return Evaluated(state, planes, law, np.inf, np.inf)
        residual = (self.membrane.residual(x, pressure) - push)[moving]
        scale = max(abs(pressure) * float(self.mesh.areas.max()), float(state.load[moving].max()))
        gap = planes.gap[moving]
        inside = np.where(state.load[moving] > 0.0, np.abs(gap), np.maximum(-gap, 0.0))
        balance = max(float(np.abs(residual).max()), off) / scale
        return Evaluated(state, planes, law, balance, max(float(inside.max()), stick_error))

    def clearance(self, surface: ObjectSurface, pose: np.ndarray) -> float:
        """Height by which to lift an object above the membrane at rest, at least 0, m."""
        lowest = float((surface.obj.vertices @ pose[2, :3]).min() + pose[2, 3])
        return max(float(self.mesh.nodes[:, 2].max()) - lowest, 0.0)

    def _planes(self, surface: ObjectSurface, state: State) -> Planes:
        outward = self.membrane.volume_gradient(state.x)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        planes = surface.planes(state.x, outward, state.pose, self.reach_m)
        return planes._replace(gap=planes.gap - self._sag(state.x, planes))

    def _sag(self, x: np.ndarray, planes: Planes) -> np.ndarray:
        """Depth in the object of flat triangles with their corners on it, (n,), m.

        Their mean depth is Σ (n_j − n_i)·(x_j − x_i)/24 over the edges; corners keep that distance,
        so that the surface and not its corners lies on the object.
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

    def solve(self, surface: ObjectSurface, start: State) -> Solved:
        """Newton's method from a state, at its pose; the state with the smallest residual."""
        here = best = self.evaluate(surface, start)
        penalty, since, count, newton = 0.0, 0, 0, None
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
                following = self._shortened(surface, here, step, always=since > 0)
                if not np.isfinite(following.residual_ratio):
                    break
            else:
                step = newton.solve(held)
                if np.abs(step.motion).max() > self.reach_m:  # too far for loads that turn
                    count += newton.factorisations
                    newton = self._step(here, turning=False)
                    step = newton.solve(held)
                penalty = max(penalty, 2.0 * float(step.load.max(initial=0.0)))
                following = self._line_search(surface, here, step, newton.residual, penalty)
            count, here = count + newton.factorisations, following
        if not best.accepted:  # loads that turn with fine fillets would look unstable
            newton = self._step(best, turning=False)
        stable = not best.is_equilibrium or (newton or self._step(best)).is_minimum()
        return Solved(best, stable, count)

    def _step(self, at: Evaluated, *, turning: bool = True) -> ContactStep:
        """Problem of Newton's step; `turning`: loads turn with the object's surface."""
        membrane, moving, state = self.membrane, self.membrane.moving, at.state
        (pressure, beta), load = self.gas_at(state.x), state.load[moving]
        planes, law, grip = at.planes.of(moving), at.law, None
        residual = membrane.residual(state.x, pressure)
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

    def _after(self, at: Evaluated, step: Step, length: float) -> State:
        """The state after a share of a step."""
        state, law, moving = at.state, at.law, self.membrane.moving
        x, load, pull = state.x.copy(), state.load.copy(), state.pull
        x[moving] += length * step.motion
        load[moving] += length * (step.load - load[moving])
        if law is not None:
            pull, grip, held = pull.copy(), law.grip.of(moving), step.held[:, None]
            turned = np.einsum("kij,kj->ki", law.stiffness[moving], step.motion)
            turned += law.start[moving]
            slips = held & grip.drag.any(axis=1, keepdims=True)
            aim = np.where(slips, step.load[:, None] * grip.drag + turned, 0.0)
            across = step.load[:, None] * at.planes.normal[moving] - step.pull
            aim = np.where(held & grip.stuck[:, None], across, aim)
            pull[moving] += length * (aim - pull[moving])
        return replace(state, x=x, load=load, pull=pull)

    def _shortened(
        self, surface: ObjectSurface, here: Evaluated, step: Step, *, always: bool
    ) -> Evaluated:
        """State after a step with friction, shortened to the smallest residual if necessary."""
        longest = max(float(np.abs(step.motion).max()), 1e-300)

        def at(share: float) -> Evaluated:
            return self.evaluate(
                surface, self._after(here, step, min(share, self.reach_m / longest))
            )

        following = at(1.0)
        if always or not np.isfinite(following.residual_ratio):  # cycling, or too far
            following = min([following, *map(at, _SHARES)], key=lambda each: each.residual_ratio)
        return following

    def _line_search(
        self,
        surface: ObjectSurface,
        here: Evaluated,
        step: Step,
        residual: np.ndarray,
        penalty: float,
    ) -> Evaluated:
        """State after the share of a step that reduces the energy with a penalty on penetration.

        Steps that are short for the mesh are taken whole if they halve the residual.
        """
        inside = self._inside(here)
        slope = float(np.sum(residual * step.motion)) - penalty * inside
        now = self.energy(here.state.x) + penalty * inside
        most = max(float(np.abs(step.motion).max()), 1e-300)
        length = min(1.0, self.reach_m / most)
        limit = now + 1e-13 * abs(now)  # with rounding

        def at(state: State, length: float) -> tuple[Evaluated, bool]:
            following = self.evaluate(surface, state)
            value = self.energy(state.x) + penalty * self._inside(following)
            return following, value <= limit + _ARMIJO * length * slope

        if most < _SHORT * self.reach_m:
            following, falls = at(self._after(here, step, 1.0), 1.0)
            if falls or following.residual_ratio < 0.5 * here.residual_ratio:
                return following
        while True:
            following, falls = at(self._after(here, step, length), length)
            if not falls and step.held.any():
                corrected = self._second_order_corrected(following, here, step.held, length)
                following, falls = at(corrected, length)
            if falls or length < 1e-4 or most < _FINE_M:
                return following
            length *= 0.5

    def _second_order_corrected(
        self, following: Evaluated, here: Evaluated, held: np.ndarray, length: float
    ) -> State:
        """The state with the `held` nodes moved to the distance that the linearised planes predict.

        A step along a curved surface departs from it to second order, which would shorten steps
        near the solution (Maratos effect).
        """
        nodes = self.membrane.moving[held]
        gap, normal, _ = following.planes.of(nodes)
        off = gap - (1.0 - length) * here.planes.gap[nodes]
        x = following.state.x.copy()
        x[nodes] -= np.where(np.isfinite(off), off, 0.0)[:, None] * normal
        return replace(following.state, x=x)

    def _inside(self, at: Evaluated) -> float:
        """Sum of the depths of the moving nodes in the object, m."""
        return float(np.maximum(-at.planes.gap[self.membrane.moving], 0.0).sum())

    # -- result ---------------------------------------------------------------------------------

    def contact(self, solved: Solved, rim_penetration_m: float | None = None) -> RubberContact:
        """Contact of a solved state."""
        membrane, mesh, at = self.membrane, self.mesh, solved.at
        state, planes, law = at.state, at.planes, at.law
        x, load = state.x, state.load
        pressure, _ = self.gas_at(x)
        displacement = x - mesh.nodes
        moving = np.isin(np.arange(len(x)), membrane.moving)
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
            balance_residual=at.balance,
            gas_law_residual=0.0,
            iterations=solved.factorisations,
            converged=solved.accepted,
            energy_j=self.energy(x) - self.energy(mesh.nodes),
            stable=solved.stable,
            slip_m=np.full(len(x), np.nan),
            stick_error_m=off,
            cone_violation=float((over - 1.0).max(initial=0.0)),
        )
