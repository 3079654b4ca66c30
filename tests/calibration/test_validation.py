"""A known press: predicted by a right sensor and by wrong ones; γ0 from its wrench."""

import numpy as np
import pytest

from bubbleviz.calibration.tension.wrench_tension import tension_by_wrench
from bubbleviz.calibration.validation import mean_frame, validate
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import SyntheticSource

TENSION = 105.0


class WithWrench:
    """A simulated press whose force/torque sensor is turned and has a bias."""

    name = "press"

    def __init__(self, source):
        self.source, self.times_s = source, source.times_s

    def __len__(self):
        return len(self.source)

    def __getitem__(self, k):
        from dataclasses import replace

        force = self.source.truth(k).force_n[[1, 2, 0]] + (0.4, -0.6, 0.5)
        return replace(self.source[k], wrench=np.concatenate([force, np.zeros(3)]))

    def close(self):
        pass


@pytest.fixture(scope="module")
def sensor():
    sensor = load_sensor("pico_flexx_75mm")
    membrane = sensor.membrane.model_copy(update={"nodes": 400})
    pneumatics = sensor.pneumatics.model_copy(update={"tension_n_per_m": TENSION})
    return sensor.model_copy(update={"membrane": membrane, "pneumatics": pneumatics})


@pytest.fixture(scope="module")
def model(sensor):
    return SensorModel.of(sensor)


@pytest.fixture(scope="module")
def press(sensor):
    poses = np.tile(np.eye(4), (12, 1, 1))
    depth = np.concatenate([np.full(4, -0.01), np.linspace(0.006, 0.013, 8)])
    poses[:, 2, 3] = 0.05 - depth
    obj = load_object("cylinder")
    low = float(obj.vertices[:, 2].min())
    poses[:, 2, 3] -= low
    return SyntheticSource(sensor, obj, poses, DepthNoise(absolute_m=1e-4), nodes=1000)


def test_prediction_meets_the_cloud(model, press):
    found = validate(model, [press[11]], press.obj, press.poses[11])
    assert found.rms_m < 0.3e-3
    assert found.rms_m < 0.1 * found.untouched_rms_m
    assert found.rms_m < found.p95_m < 3.0 * found.rms_m
    assert found.patch_overlap > 0.6
    truth = press.truth(11).force_n
    # Other mesh, sharp edge: contact begins and ends with whole nodes.
    assert found.predicted_force_n == pytest.approx(truth, abs=0.12 * np.linalg.norm(truth))
    assert len(found.points_m) == len(found.distance_m) == len(found.pixels)


def test_a_wrong_pose_shows(model, press):
    shifted = press.poses[11].copy()
    shifted[:3, 3] += (0.006, 0.0, 0.002)
    right = validate(model, [press[11]], press.obj, press.poses[11])
    wrong = validate(model, [press[11]], press.obj, shifted)
    assert wrong.rms_m > 2.0 * right.rms_m
    assert wrong.patch_overlap < right.patch_overlap


def test_several_frames_average_their_noise(model, press):
    frames = [press[11]] * 2
    assert validate(model, frames, press.obj, press.poses[11]).rms_m < 0.3e-3
    with pytest.raises(InputError, match="no frames"):
        validate(model, [], press.obj, press.poses[11])


def test_wrench_finds_the_tension_it_was_not_told(model, press):
    start = model.with_tension(130.0)
    found = tension_by_wrench(WithWrench(press), start, range(4), (5, 7, 9, 11), (6, 8, 10))
    assert found.tension_n_per_m == pytest.approx(TENSION, rel=0.12)
    assert not found.at_limit
    assert found.tested_rms_n < found.given_rms_n
    assert found.tested_rms_n < 0.1 * found.measured_n.mean()
    truth = [np.linalg.norm(press.truth(k).force_n) for k in (6, 8, 10)]
    np.testing.assert_allclose(found.measured_n, truth, rtol=1e-6)
    np.testing.assert_allclose(found.predicted_n, truth, rtol=0.15)


def test_wrench_needs_a_wrench_and_two_parts(model, press):
    with pytest.raises(InputError, match="no wrench"):
        tension_by_wrench(press, model, range(2), (5,), (6,))
    with pytest.raises(InputError, match="others to test"):
        tension_by_wrench(WithWrench(press), model, range(2), (5, 6), (6,))


def test_the_mean_of_frames_leaves_out_what_most_did_not_see():
    depth = np.array([[[1.0, 2.0, np.nan, np.nan]], [[3.0, np.nan, np.nan, np.nan]],
                      [[5.0, 4.0, 7.0, np.nan]]], np.float32)  # fmt: skip
    frames = [Frame(k, 0.0, image, gas_pressure_pa=1e5 + k) for k, image in enumerate(depth)]
    mean = mean_frame(frames)
    np.testing.assert_allclose(mean.depth_m, [[3.0, 3.0, np.nan, np.nan]])
    assert mean.gas_pressure_pa == pytest.approx(1e5 + 1.0)
    assert mean_frame([*frames, Frame(3, 0.0, depth[0])]).gas_pressure_pa is None
