"""Presses into the exact membrane or the linear one, as the camera would see them."""

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
from bubbleviz.sensor import Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.synthetic_source import simulation_mesh

# Presses into the exact membrane on a mesh made finer where an object touches, most at its edges.
#
# The forward model holds nodes. Where an edge of the object lies between them it cuts into the
# membrane, so that on an even mesh the contact is smaller than the object by half a triangle, and
# nodes catch on the edge, which is then no longer without friction. Here edges have a radius, and
# the mesh is fine enough to slide over them.


EDGE_RADIUS_M = 5e-4
"""Of objects' edges: those of printed and machined parts, about as thick as the rubber is."""

_LEVELS = 4  # how often triangles are cut at most


class RefinedPress(NamedTuple):
    """A press and the mesh it was found on."""

    mesh: MembraneMesh
    contact: RubberContact


def refined_press(
    # the membrane on a mesh whose nodes are on the facets of `mesh`, which it may move a little
    rubber_on: Callable[[MembraneMesh], RubberMembrane],
    gas_on: Callable[[MembraneMesh], Gas],  # the gas behind it
    mesh: MembraneMesh,  # to begin with
    obj: RigidObject,
    T_B_O: np.ndarray,  # (4, 4)
) -> RefinedPress:
    """Press an object; the contact may not have converged."""

    def forward_on(mesh: MembraneMesh) -> RubberForward:
        rubber = rubber_on(mesh)
        return RubberForward(rubber, gas_on(rubber.mesh), EDGE_RADIUS_M)

    surface = ObjectSurface(obj, EDGE_RADIUS_M)
    forward = forward_on(mesh)
    contact = forward.press(obj, T_B_O, quick=True)
    for level in range(_LEVELS):
        cut = _coarse(forward.mesh, contact, surface, T_B_O, everywhere=level == 0)
        if not cut.any():
            break
        finer = refinement(mesh, cut)
        mesh, forward = finer.mesh, forward_on(finer.mesh)
        near = (finer.values(contact.displacement_3d_m), finer.values(contact.contact_pressure_pa))
        contact = forward.press(obj, T_B_O, near, quick=True)
    if not contact.converged:
        contact = forward.press(obj, T_B_O)
    return RefinedPress(forward.mesh, contact)


def _coarse(
    mesh: MembraneMesh,
    found: RubberContact,
    surface: ObjectSurface,
    T_B_O: np.ndarray,
    everywhere: bool,
) -> np.ndarray:
    """Touching triangles (m,) bool that are too large for the edge they lie on, or all that touch.

    With those beside them, for a contact grows as its edge is resolved.
    """
    pressed = MembraneMesh(mesh.deformed(found.displacement_3d_m), mesh.triangles, mesh.rim)
    cut = (found.contact_pressure_pa > 0.0)[mesh.triangles].any(axis=1)
    if not everywhere:
        cut &= surface.turn_along(pressed, T_B_O, 2.0 * mesh.edge_length) > MOST_TURN_RAD
    beside = np.zeros(len(mesh.nodes), bool)
    beside[mesh.triangles[cut]] = True
    chosen: np.ndarray = beside[mesh.triangles].any(axis=1)
    return chosen


PRESTRETCH = 1.2  # λ of sensors whose file has none: that of the real one (`identify`)

TRUTH_NODES = 2_600
"""Before it is refined: other nodes than the estimator's, and as coarse where nothing touches."""
LINEAR_NODES = 12_500  # of the linear model, which costs little: about 15 times the estimator's 800


class RubberTruth(NamedTuple):
    """A press as the camera would see it without noise."""

    T_B_O: np.ndarray  # (4, 4)
    mesh: MembraneMesh
    contact: Contact
    range_m: np.ndarray  # (H, W), NaN where a ray misses the membrane


@dataclass(frozen=True)
class Presses(ABC):
    """Presses objects into one membrane."""

    camera: DepthCamera  # that sees it
    mesh: MembraneMesh  # reference surface
    pneumatics: Pneumatics  # the gas behind it

    def press(self, obj: RigidObject, T_B_O: np.ndarray) -> RubberTruth:
        """Press an object at a pose (4, 4).

        Raises InputError, SolveError: the pose cuts the rim, or has no equilibrium.
        """
        mesh, contact = self.solved(obj, T_B_O)
        if not contact.converged:
            raise SolveError(f"no equilibrium of {obj.name} at this pose")
        view = MembraneView(self.camera, mesh)
        return RubberTruth(T_B_O, mesh, contact, view.range_image(contact.displacement_3d_m))

    @abstractmethod
    def solved(self, obj: RigidObject, T_B_O: np.ndarray) -> tuple[MembraneMesh, Contact]:
        """Contact at a pose, converged or not, and the mesh that it is on."""


@dataclass(frozen=True)
class RubberPresses(Presses):
    """Presses objects into one exact membrane, on a mesh finer where they touch."""

    # the membrane on a mesh whose nodes are on the facets of `mesh`, which it may move a little
    rubber: Callable[[MembraneMesh], RubberMembrane]

    @classmethod
    def of(cls, model: SensorModel, nodes: int = TRUTH_NODES) -> RubberPresses:
        """Those of a sensor as its file describes it, on a mesh of about so many nodes."""
        rubber = partial(_rubber_of, model.sensor, model.tension_n_per_m)
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
        """Those of a sensor, on a mesh of about so many nodes."""
        mesh = simulation_mesh(model, nodes)
        return cls(model.camera, mesh, model.sensor.pneumatics, model.tension_n_per_m)

    def solved(self, obj: RigidObject, T_B_O: np.ndarray) -> tuple[MembraneMesh, Contact]:
        gas = Gas.of(self.pneumatics, self.mesh)
        contact = ForwardModel(self.mesh, self.tension_n_per_m, gas).press(obj, T_B_O)
        if contact.rim_penetration_m > 1e-6:
            raise InputError(f"{obj.name} cuts into the clamped rim")
        return self.mesh, contact


def _rubber_of(sensor: Sensor, tension_n_per_m: float, mesh: MembraneMesh) -> RubberMembrane:
    return build_rubber(sensor, mesh, tension_n_per_m)


def rubber_sensor(sensor: Sensor) -> Sensor:
    """The sensor, of rubber where its file does not say so."""
    if sensor.membrane.prestretch is not None:
        return sensor
    membrane = sensor.membrane.model_copy(update={"prestretch": PRESTRETCH})
    return sensor.model_copy(update={"membrane": membrane})
