"""A small press simulated on another, finer mesh, and the rubber dome of another solver."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.calibration import write_sensor
from bubbleviz.camera import DepthCamera, MembraneView, RangeObserver
from bubbleviz.inverse import ConstantTension, Estimator, EstimatorOptions, PaperEstimator
from bubbleviz.membrane import Contact, ForwardModel, Gas, MembraneMesh, build_mesh
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from tests.membrane.domes import pose
from tests.rubber_renders import GAUGE_PA, at_rest, camera_of, dome_sensor, render, rubber_truth

SENSOR = load_sensor("pico_flexx_75mm")
CAMERA = DepthCamera.of(SENSOR.camera)
GAUGE = SENSOR.pneumatics.gauge_pressure_pa
TENSION = GAUGE * (0.075**2 + 0.05**2) / (2 * 0.05) / 2  # Young–Laplace of the exact cap


@dataclass(frozen=True)
class Press:
    """A pressed membrane and its depth images."""

    mesh: MembraneMesh
    contact: Contact
    range_m: np.ndarray

    @property
    def force(self):
        return -(self.mesh.areas * self.contact.contact_pressure_pa) @ self.mesh.normals

    def depth(self, noise, seed=0):
        rng = np.random.default_rng(seed)
        noisy = self.range_m * (1 + noise * rng.standard_normal(self.range_m.shape))
        return CAMERA.depth_image(noisy).astype(np.float32)


@cache
def fine_mesh():
    return build_mesh(SENSOR, 6000)


@cache
def press(name, depth_m, place_m=(0.006, -0.004)):
    mesh = fine_mesh()
    model = ForwardModel(mesh, TENSION, Gas.of(SENSOR.pneumatics, mesh))
    contact = model.press(load_object(name), pose(*place_m, 0.05 - depth_m))
    return Press(mesh, contact, MembraneView(CAMERA, mesh).range_image(contact.displacement_m))


@pytest.fixture(scope="session")
def sphere():
    return press("sphere", 0.012)


@pytest.fixture(scope="session")
def untouched():
    return press("sphere", -0.01)


@cache
def estimator(nodes=500, solver=None, **options):
    mesh = build_mesh(SENSOR, nodes)
    observer = RangeObserver(CAMERA, mesh, SENSOR.camera.noise_relative, block=3)
    film = ConstantTension(mesh, TENSION, Gas.of(SENSOR.pneumatics, mesh))
    kind = PaperEstimator if solver == "paper" else Estimator
    return kind(observer, film, EstimatorOptions(**options))


def first(solver, depth_m, gas_pressure_pa=None):
    """Estimate of a first frame."""
    return solver.estimate(depth_m, gas_pressure_pa)[0]


DOME_CAMERA = camera_of(320)


def dome_images(truth, shapes, gauge, noise_m=5e-5, seed=0):
    return render(
        "dome", DOME_CAMERA, shapes, truth["triangles"], gauge, noise_m=noise_m, seed=seed
    )


@pytest.fixture(scope="session")
def identified(tmp_path_factory):
    """Sensor file of the rubber dome, identified from its own levels and open chamber."""
    truth, path = rubber_truth("ball_drag1"), tmp_path_factory.mktemp("identified") / "dome.toml"
    levels = [
        dome_images(truth, at_rest(shape, 10), gauge, seed=1)
        for shape, gauge in zip(truth["level_m"], truth["level_pa"], strict=True)
    ]
    rest = dome_images(truth, at_rest(truth["rest_m"]), GAUGE_PA)
    vented = dome_images(truth, at_rest(truth["vented_m"], 5), 0.0)
    found = bv.identify(rest, dome_sensor(DOME_CAMERA), levels=levels, vented=vented).found
    write_sensor(found, path)  # without a verdict, and its simulated press
    return path
