"""Presses into the exact membrane, on a mesh that is fine where the object touches.

The forward model holds nodes: where an edge of the object lies between them it cuts into the
membrane, so that on an even mesh the contact is smaller than the object by a triangle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.errors import SolveError
from bubbleviz.membrane.forward_model import Contact
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.reference_mesh import build_rubber
from bubbleviz.membrane.refine import refine
from bubbleviz.membrane.rubber_model.rubber_forward import RubberForward
from bubbleviz.pose.object_model import ObjectModel
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
    """Presses objects into the exact membrane of one sensor.

    Attributes
    ----------
    model : SensorModel
    nodes : int
        Of the mesh before it is refined.
    """

    model: SensorModel
    nodes: int = TRUTH_NODES

    @property
    def mesh(self) -> MembraneMesh:
        """Mesh before it is refined."""
        return simulation_mesh(self.model, self.nodes)

    def press(self, model: ObjectModel, T_B_O: np.ndarray) -> RubberTruth:
        """Press an object at a pose (4, 4).

        Raises
        ------
        SolveError
            No equilibrium was found.
        """
        mesh = self.mesh
        contact = self._solved(mesh, model, T_B_O)
        touching = np.flatnonzero(contact.contact_pressure_pa > 0.0)
        places = mesh.nodes[touching]
        edges = np.ones(len(places), bool)
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
        contact = self._solved(mesh, model, T_B_O)
        if not contact.converged:
            raise SolveError(f"no equilibrium of {model.obj.name} at this pose")
        view = MembraneView(self.model.camera, mesh)
        return RubberTruth(T_B_O, mesh, contact, view.range_image(contact.displacement_3d_m))

    def _solved(self, mesh: MembraneMesh, model: ObjectModel, T_B_O: np.ndarray) -> Contact:
        own = self.model
        rubber = build_rubber(own.sensor, mesh, own.tension_n_per_m)
        return RubberForward(rubber, Gas.of(own.sensor.pneumatics, mesh)).press(model.obj, T_B_O)
