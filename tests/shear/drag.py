"""A small sensor, and objects that stick to its membrane: truths on another, finer mesh."""

from __future__ import annotations

from functools import cache

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.reference_mesh import build_mesh, build_rubber
from bubbleviz.membrane.rubber_model.rubber_forward import RubberForward
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.shear.traction_estimator import TractionOptions
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.press_path import touching_height
from bubbleviz.study import object_shapes
from bubbleviz.study.shear.flow_sighting import FlowSighting, sighting
from bubbleviz.study.shear.stuck_press import Motion, StuckPress, StuckTruth

NOISE = DepthNoise(absolute_m=5e-5)
FLOW_PX = 0.03


def sensor(nodes: int = 600) -> Sensor:
    """A dome of rubber over a camera of half the usual size."""
    return Sensor(
        name="dome",
        membrane=Membrane(
            shape="spherical_cap",
            rim_radius_m=0.045,
            height_m=0.020,
            nodes=nodes,
            prestretch=1.2,
        ),
        pneumatics=Pneumatics(gauge_pressure_pa=6000.0, chamber_volume_m3=3e-4),
        camera=Camera(
            width=400,
            height=320,
            fx=260.0,
            fy=260.0,
            cx=199.5,
            cy=159.5,
            position_m=(0.0, 0.0, -0.06),
            noise_relative=6e-4,
        ),
    )


@cache
def press(name: str, depth_m: float, nodes: int = 1400) -> tuple[StuckPress, np.ndarray]:
    """An object pressed in off the axis, and the distance of each node from its middle, m."""
    model = SensorModel.of(sensor())
    mesh = build_mesh(model.sensor, nodes)
    rubber = build_rubber(model.sensor, mesh, model.tension_n_per_m)
    gas = Gas.of(model.sensor.pneumatics, mesh)
    obj, T = getattr(object_shapes, name)(), np.eye(4)
    T[:2, 3] = 0.005, -0.003
    T[2, 3] = touching_height(obj, T, mesh) - depth_m
    contact = RubberForward(rubber, gas).press(obj, T)
    touching = contact.contact_pressure_pa > 0.0
    now = mesh.nodes + contact.displacement_3d_m
    away = np.linalg.norm((now - now[touching].mean(axis=0))[:, :2], axis=1)
    return StuckPress(rubber, gas, contact.displacement_3d_m, touching), away


@cache
def stuck(name: str, depth_m: float, drag_m: float, twist_deg: float) -> StuckTruth:
    """The object dragged aside and twisted, with all that touched it."""
    drag = np.array([drag_m, 0.4 * drag_m, 0.0])
    return press(name, depth_m)[0].moved(Motion(drag, np.radians(twist_deg)))


class Eyes:
    """A pipeline of the sensor and what its cameras see of truths, frame after frame."""

    def __init__(self, nodes: int = 600, **options: float) -> None:
        self.pipeline = Pipeline.of(sensor(nodes))
        self.flows: list[FlowSighting] = []
        chosen = TractionOptions(**options)
        self.pipeline.watch_texture(lambda frame: self.flows[frame.index].flow, options=chosen)

    def see(self, truth: StuckTruth, seed: int = 0) -> Frame:
        """The next frame."""
        seen = sighting(self.pipeline.camera, truth, NOISE, FLOW_PX, seed)
        self.flows.append(seen)
        index = len(self.flows) - 1
        return Frame(index, index / 30.0, seen.depth_m)

    def rest(self) -> Frame:
        """The next frame, of the membrane at rest."""
        mesh = self.pipeline.mesh
        still = np.zeros_like(mesh.nodes)
        return self.see(StuckTruth(mesh, still, still, mesh.normals, 0.0))
