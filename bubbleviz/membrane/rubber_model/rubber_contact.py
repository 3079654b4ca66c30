"""An exact membrane with the gas behind it and what touches it: energy, loads, certificates."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.membrane.forward_model import Contact
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.rubber_model.contact_step import ContactStep
from bubbleviz.membrane.rubber_model.friction_law import Friction
from bubbleviz.membrane.rubber_model.object_surface import MOST_TURN_RAD, ObjectSurface, Planes
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factoriser, NodeBlocks

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
