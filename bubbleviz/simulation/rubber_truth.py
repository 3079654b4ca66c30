"""Presses into the exact or the linear membrane, with ground truth and noise-free ranges."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from bubbleviz.camera import DepthCamera, MembraneView
from bubbleviz.errors import InputError, SolveError
from bubbleviz.membrane import (
    MOST_TURN_RAD,
    Contact,
    ForwardModel,
    Gas,
    MembraneMesh,
    ObjectSurface,
    RubberContact,
    RubberForward,
    RubberMembrane,
    build_rubber,
    refinement,
)
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Pneumatics, Sensor, changed
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.synthetic_source import Truth, simulation_mesh

# Presses into the exact membrane on a mesh that is refined in the contact, most at edges.
#
# The forward model imposes contact at nodes. An edge of the object between nodes cuts into the
# membrane. So on a uniform mesh the contact is too small by half a triangle, and nodes that catch
# on the edge act like friction. Here edges have a radius, and the mesh is fine enough to slide over
# them.


EDGE_RADIUS_M = 5e-4
"""Radius of objects' edges, typical of printed and machined parts; about the rubber's thickness."""

_MAX_LEVELS = 4  # of refinement


def refined_press(
    # membrane on a refinement of `mesh`, whose nodes it may move slightly
    rubber_on: Callable[[MembraneMesh], RubberMembrane],
    gas_on: Callable[[MembraneMesh], Gas],
    mesh: MembraneMesh,  # before refinement
    obj: RigidObject,
    T_B_O: np.ndarray,  # (4, 4)
) -> tuple[MembraneMesh, RubberContact]:
    """Press an object; the refined mesh, and the contact, which may not have converged.

    Edges are first as round as the mesh is coarse, and become sharper as it is refined: an edge
    that is too sharp for the mesh has many equilibria, between which Newton's method wanders.
    """

    def forward_on(mesh: MembraneMesh, radius_m: float) -> RubberForward:
        rubber = rubber_on(mesh)
        return RubberForward(rubber, gas_on(rubber.mesh), EDGE_RADIUS_M, radius_m)

    roundest_m = max(mesh.edge_length / MOST_TURN_RAD, EDGE_RADIUS_M)
    radius_m, *radii = np.geomspace(roundest_m, EDGE_RADIUS_M, _MAX_LEVELS + 1).tolist()
    forward = forward_on(mesh, radius_m)
    contact = forward.press(obj, T_B_O, quick=True)
    for level, following_m in enumerate(radii):
        surface = ObjectSurface(obj, EDGE_RADIUS_M, following_m)
        cut = _to_refine(forward.mesh, contact, surface, T_B_O, everywhere=level == 0)
        if not cut.any() and radius_m == EDGE_RADIUS_M:
            break
        radius_m = following_m if cut.any() else EDGE_RADIUS_M
        finer = refinement(mesh, cut)
        mesh, forward = finer.mesh, forward_on(finer.mesh, radius_m)
        start = finer.values(contact.displacement_3d_m), finer.values(contact.contact_pressure_pa)
        contact = forward.press(obj, T_B_O, start, quick=True)
    if not contact.converged:
        contact = forward.press(obj, T_B_O)
    return forward.mesh, contact


def _to_refine(
    mesh: MembraneMesh,
    found: RubberContact,
    surface: ObjectSurface,
    T_B_O: np.ndarray,
    everywhere: bool,
) -> np.ndarray:
    """Triangles (m,) bool in contact (all, or those too large for an edge), and their neighbours.

    Neighbours are included because the contact grows as its edge is resolved.
    """
    pressed = MembraneMesh(mesh.deformed(found.displacement_3d_m), mesh.triangles, mesh.rim)
    cut = (found.contact_pressure_pa > 0.0)[mesh.triangles].any(axis=1)
    if not everywhere:
        cut &= surface.turn_along(pressed, T_B_O, 2.0 * mesh.edge_length) > MOST_TURN_RAD
    near = np.zeros(len(mesh.nodes), bool)
    near[mesh.triangles[cut]] = True
    chosen: np.ndarray = near[mesh.triangles].any(axis=1)
    return chosen


PRESTRETCH = 1.2  # λ for sensor files without one; identified on the real sensor

TRUTH_NODES = 2_600
"""Before refinement; nodes differ from the estimator's."""
LINEAR_NODES = 12_500  # of the linear model, which is fast: about 15 times the estimator's 800


class SimulatedPress(NamedTuple):
    """A press with ground truth and noise-free ranges."""

    T_B_O: np.ndarray  # (4, 4)
    mesh: MembraneMesh  # reference surface of the truth
    truth: Truth
    range_m: np.ndarray  # (H, W), range along each ray; NaN where it misses the membrane


@dataclass(frozen=True)
class Presses(ABC):
    """Presses objects into one membrane."""

    camera: DepthCamera
    mesh: MembraneMesh  # reference surface
    pneumatics: Pneumatics

    def press(self, obj: RigidObject, T_B_O: np.ndarray) -> SimulatedPress:
        """Press an object at a pose (4, 4).

        Raises InputError, SolveError: the pose cuts the rim, or has no equilibrium.
        """
        mesh, contact = self.solved(obj, T_B_O)
        if not contact.converged:
            raise SolveError(f"no equilibrium of {obj.name} at this pose; press it less deep")
        view = MembraneView(self.camera, mesh)
        ranges = view.range_image(contact.displacement_3d_m)
        return SimulatedPress(T_B_O, mesh, Truth.of(contact, view), ranges)

    @abstractmethod
    def solved(self, obj: RigidObject, T_B_O: np.ndarray) -> tuple[MembraneMesh, Contact]:
        """Contact at a pose, converged or not, and its mesh."""


@dataclass(frozen=True)
class RubberPresses(Presses):
    """Presses objects into the exact membrane, on a mesh refined in the contact."""

    # membrane on a refinement of `mesh`, whose nodes it may move slightly
    rubber: Callable[[MembraneMesh], RubberMembrane]

    @classmethod
    def of(cls, model: SensorModel, nodes: int = TRUTH_NODES) -> RubberPresses:
        """Presses into a sensor's membrane, on a mesh of about `nodes` nodes."""
        rubber = partial(build_rubber, model.sensor, tension_n_per_m=model.tension_n_per_m)
        mesh = simulation_mesh(model, nodes)
        return cls(model.camera, mesh, model.sensor.pneumatics, rubber)

    def solved(self, obj: RigidObject, T_B_O: np.ndarray) -> tuple[MembraneMesh, Contact]:
        return refined_press(self.rubber, partial(Gas.of, self.pneumatics), self.mesh, obj, T_B_O)


@dataclass(frozen=True)
class LinearPresses(Presses):
    """Presses objects into the paper's linear membrane."""

    tension_n_per_m: float

    @classmethod
    def of(cls, model: SensorModel, nodes: int = LINEAR_NODES) -> LinearPresses:
        """Presses into a sensor's membrane, on a mesh of about `nodes` nodes."""
        mesh = simulation_mesh(model, nodes)
        return cls(model.camera, mesh, model.sensor.pneumatics, model.tension_n_per_m)

    def solved(self, obj: RigidObject, T_B_O: np.ndarray) -> tuple[MembraneMesh, Contact]:
        gas = Gas.of(self.pneumatics, self.mesh)
        contact = ForwardModel(self.mesh, self.tension_n_per_m, gas).press(obj, T_B_O)
        if contact.rim_penetration_m > 1e-6:
            raise InputError(
                f"{obj.name} cuts into the clamped rim; raise the object or move it inward"
            )
        return self.mesh, contact


def rubber_sensor(sensor: Sensor) -> Sensor:
    """The sensor with a pre-stretch, by default 1.2."""
    if sensor.membrane.prestretch is not None:
        return sensor
    return changed(sensor, membrane={"prestretch": PRESTRETCH})
