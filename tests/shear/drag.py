"""A small sensor, and objects that stick to its membrane, simulated on a finer mesh."""

from functools import cache

import numpy as np

from bubbleviz.inverse import EstimatorOptions
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.simulation import DepthNoise
from tests.oracles.flow_sighting import FlowSighting, sighting
from tests.oracles.stuck_press import Motion, ShearTruth, pressed, shear_sensor
from tests.small_press import changed

NOISE = DepthNoise(absolute_m=5e-5)
FLOW_PX = 0.03


def sensor(nodes=600):
    """The study's dome over a camera of fewer pixels."""
    whole = shear_sensor(nodes)
    fewer = {"width": 400, "height": 320, "fx": 260.0, "fy": 260.0, "cx": 199.5, "cy": 159.5}
    return changed(whole, camera=fewer)


@cache
def press(name, depth_m, nodes=1400):
    """An object pressed in off the axis, and the distance of each node from its middle, m."""
    found = pressed(sensor(), name, depth_m, nodes)
    x = found.pressed_m
    away = np.linalg.norm((x - x[found.touching].mean(axis=0))[:, :2], axis=1)
    return found, away


@cache
def stuck(name, depth_m, drag_m, twist_deg):
    """The object dragged aside and twisted, with all that touched it."""
    drag = np.array([drag_m, 0.4 * drag_m, 0.0])
    return press(name, depth_m)[0].moved(Motion(drag, np.radians(twist_deg)))


class Eyes:
    """A pipeline of the sensor and rendered images of simulated frames, in order."""

    def __init__(self, nodes=600, **options):
        self.pipeline = Pipeline.of(sensor(nodes), options=EstimatorOptions(**options))
        self.flows: list[FlowSighting] = []
        self.pipeline.use_optical_flow(lambda frame: self.flows[frame.index].flow)

    def see(self, truth, seed=0, flow_px=FLOW_PX, noise=NOISE):
        """The next frame."""
        seen = sighting(self.pipeline.camera, truth, noise, flow_px, seed)
        self.flows.append(seen)
        index = len(self.flows) - 1
        return Frame(index, index / 30.0, seen.depth_m)

    def solve(self, frame):
        """Estimate of a frame by depth and flow, and its traction."""
        result = self.pipeline.process(frame, frozenset({"traction"}))
        return result.estimate, result.traction

    def rest(self):
        """The next frame, of the membrane at rest."""
        mesh = self.pipeline.mesh
        still = np.zeros_like(mesh.nodes)
        return self.see(ShearTruth(mesh, still, still, mesh.normals))
