"""Presses into the exact membrane, on a mesh that is fine where the object touches.

The forward model holds nodes: where an edge of the object lies between them it cuts into the
membrane, so that on an even mesh the contact is smaller than the object by a triangle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.errors import SolveError
from bubbleviz.membrane.forward_model import Contact
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.reference_mesh import build_rubber
from bubbleviz.membrane.refine import refine
from bubbleviz.membrane.rubber_model.rubber_forward import RubberForward
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.sensor import Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.synthetic_source import simulation_mesh

PRESTRETCH = 1.2
"""λ of sensors whose file has none: that of the real one (`identify`)."""

TRUTH_NODES = 2_600
"""Before it is refined: other nodes than the estimator's, and as coarse where nothing touches."""

_AROUND = 1.5
"""Way around touching nodes, in edges of the mesh, in which triangles are cut at each level: a
contact that becomes larger on the finer mesh stays in it."""

_LEVELS, _AT_EDGES = 1, 2
"""Levels around all that touches, and more of them along edges of the object."""


class RubberTruth(NamedTuple):
    """A press as the camera would see it without noise.

    Attributes
    ----------
    T_B_O : (4, 4) array
    mesh : MembraneMesh
    contact : Contact
    range_m : (H, W) array
        NaN where a ray misses the membrane.
    """

    T_B_O: np.ndarray
    mesh: MembraneMesh
    contact: Contact
    range_m: np.ndarray


@dataclass(frozen=True)
class RubberPresses:
    """Presses objects into one exact membrane.

    Attributes
    ----------
    camera : DepthCamera
        That sees it.
    mesh : MembraneMesh
        Before it is refined.
    rubber : callable
        The membrane on a mesh whose nodes are on the facets of `mesh`, which it may move a little.
    pneumatics : Pneumatics
    """

    camera: DepthCamera
    mesh: MembraneMesh
    rubber: Callable[[MembraneMesh], RubberMembrane]
    pneumatics: Pneumatics

    @classmethod
    def of(cls, model: SensorModel, nodes: int = TRUTH_NODES) -> RubberPresses:
        """Those of a sensor as its file describes it, on a mesh of about so many nodes."""
        rubber = partial(_rubber_of, model.sensor, model.tension_n_per_m)
        mesh = simulation_mesh(model, nodes)
        return cls(model.camera, mesh, rubber, model.sensor.pneumatics)

    def press(self, model: ObjectModel, T_B_O: np.ndarray) -> RubberTruth:
        """Press an object at a pose (4, 4).

        Raises
        ------
        SolveError
            No equilibrium was found.
        """
        mesh, contact = self._solved(self.mesh, model, T_B_O)
        touching = np.flatnonzero(contact.contact_pressure_pa > 0.0)
        places = mesh.nodes[touching]
        edges = np.zeros(len(places), bool)
        if model.creases is not None:
            now = mesh.deformed(contact.displacement_3d_m)[touching]
            local = (now - T_B_O[:3, 3]) @ T_B_O[:3, :3]
            edges = model.creases.tree.query(local)[0] < 0.5 * mesh.edge_length
        edge_m = mesh.edge_length
        for level in range(_LEVELS + _AT_EDGES):
            chosen = places if level < _LEVELS else places[edges]
            if len(chosen):
                away = np.asarray(cKDTree(chosen).query(mesh.nodes)[0])
                near = (away < _AROUND * edge_m)[mesh.triangles].any(axis=1)
                mesh, edge_m = refine(mesh, near), 0.7 * edge_m
        mesh, contact = self._solved(mesh, model, T_B_O)
        if not contact.converged:
            raise SolveError(f"no equilibrium of {model.obj.name} at this pose")
        view = MembraneView(self.camera, mesh)
        return RubberTruth(T_B_O, mesh, contact, view.range_image(contact.displacement_3d_m))

    def _solved(
        self, mesh: MembraneMesh, model: ObjectModel, T_B_O: np.ndarray
    ) -> tuple[MembraneMesh, Contact]:
        rubber = self.rubber(mesh)
        gas = Gas.of(self.pneumatics, rubber.mesh)
        return rubber.mesh, RubberForward(rubber, gas).press(model.obj, T_B_O)


def _rubber_of(sensor: Sensor, tension_n_per_m: float, mesh: MembraneMesh) -> RubberMembrane:
    return build_rubber(sensor, mesh, tension_n_per_m)


def rubber_sensor(sensor: Sensor) -> Sensor:
    """The sensor, of rubber where its file does not say so."""
    if sensor.membrane.prestretch is not None:
        return sensor
    membrane = sensor.membrane.model_copy(update={"prestretch": PRESTRETCH})
    return sensor.model_copy(update={"membrane": membrane})
