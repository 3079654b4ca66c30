"""A small sensor, and objects that stick to its membrane, simulated on a finer mesh."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import Gas, RubberForward, build_mesh, build_rubber
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, study_object, touching_height
from tests.oracles.flow_sighting import FlowSighting, sighting
from tests.oracles.stuck_press import OFFSET_M, Motion, ShearTruth, pressed, shear_sensor
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


def slides(name, depth_m, friction, poses):
    """A pressed object with Coulomb's friction, moved by `poses`: drags along x, m, and twists.

    Also the share of the contact that slid by more than 0.1 mm, and the longest slip.
    """
    found, obj = sensor(), study_object(name)
    mesh, aim = build_mesh(found, 1000), np.eye(4)
    aim[:2, 3] = OFFSET_M
    aim[2, 3] = touching_height(obj, aim, mesh) - depth_m
    rubber = build_rubber(found, mesh, SensorModel.of(found).tension_n_per_m)
    forward = RubberForward(rubber, Gas.of(found.pneumatics, mesh))
    path = []
    for drag_m, twist_rad in poses:
        pose = aim.copy()
        pose[0, 3] += drag_m
        pose[:3, :3] = Rotation.from_rotvec([0.0, 0.0, twist_rad]).as_matrix()
        path.append(pose)
    slid_m, start = np.zeros(len(mesh.nodes)), forward.press(obj, path[0])
    for contact in forward.follow(obj, path, friction, start):
        touching = contact.contact_pressure_pa > 0.0
        slid_m = np.where(touching, slid_m + contact.slip_m, 0.0)
        now = replace(mesh, nodes=mesh.deformed(contact.displacement_3d_m))
        share = now.areas @ (slid_m > 1e-4) / now.areas[touching].sum()
        moved = contact.displacement_3d_m
        yield ShearTruth(mesh, moved, contact.nodal_force_n, now.normals), share, slid_m.max()


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
