"""Presses into the exact membrane, as the camera would see them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.errors import SolveError
from bubbleviz.membrane.forward_model import Contact
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.reference_mesh import build_rubber
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.sensor import Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.refined_press import refined_press
from bubbleviz.simulation.synthetic_source import simulation_mesh

PRESTRETCH = 1.2  # λ of sensors whose file has none: that of the real one (`identify`)

TRUTH_NODES = 2_600
"""Before it is refined: other nodes than the estimator's, and as coarse where nothing touches."""


class RubberTruth(NamedTuple):
    """A press as the camera would see it without noise."""

    T_B_O: np.ndarray  # (4, 4)
    mesh: MembraneMesh
    contact: Contact
    range_m: np.ndarray  # (H, W), NaN where a ray misses the membrane


@dataclass(frozen=True)
class RubberPresses:
    """Presses objects into one exact membrane."""

    camera: DepthCamera  # that sees it
    mesh: MembraneMesh  # before it is refined
    # the membrane on a mesh whose nodes are on the facets of `mesh`, which it may move a little
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

        Raises SolveError: no equilibrium was found.
        """
        mesh, contact = refined_press(
            self.rubber, partial(Gas.of, self.pneumatics), self.mesh, model.obj, T_B_O
        )
        if not contact.converged:
            raise SolveError(f"no equilibrium of {model.obj.name} at this pose")
        view = MembraneView(self.camera, mesh)
        return RubberTruth(T_B_O, mesh, contact, view.range_image(contact.displacement_3d_m))


def _rubber_of(sensor: Sensor, tension_n_per_m: float, mesh: MembraneMesh) -> RubberMembrane:
    return build_rubber(sensor, mesh, tension_n_per_m)


def rubber_sensor(sensor: Sensor) -> Sensor:
    """The sensor, of rubber where its file does not say so."""
    if sensor.membrane.prestretch is not None:
        return sensor
    membrane = sensor.membrane.model_copy(update={"prestretch": PRESTRETCH})
    return sensor.model_copy(update={"membrane": membrane})
