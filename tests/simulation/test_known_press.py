"""A known press, predicted by a right sensor file and by wrong ones."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.recordings import Frame
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    DepthNoise,
    SyntheticSource,
    Validation,
    mean_frame,
    touching_height,
)
from tests.small_press import changed

TENSION = 105.0


@pytest.fixture(scope="module")
def sensor():
    sensor = load_sensor("pico_flexx_75mm")
    return changed(sensor, membrane={"nodes": 400}, pneumatics={"tension_n_per_m": TENSION})


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


def test_prediction_matches_the_cloud(model, press):
    found = Validation.of(model, [press[11]], press.obj, press.poses[11])
    assert found.rms_m < 0.3e-3
    assert found.rms_m < 0.1 * found.untouched_rms_m
    assert found.rms_m < found.p95_m < 3.0 * found.rms_m
    assert found.patch_overlap > 0.45  # an edge between two nodes
    truth = press.truth(11).force_n
    # Other mesh, sharp edge: contact begins and ends with whole nodes.
    assert found.predicted_force_n == pytest.approx(truth, abs=0.12 * np.linalg.norm(truth))
    assert len(found.points_m) == np.count_nonzero(np.isfinite(found.distance_m))


def test_wrong_pose_is_detected(model, press):
    shifted = press.poses[11].copy()
    shifted[:3, 3] += (0.006, 0.0, 0.002)
    right = Validation.of(model, [press[11]], press.obj, press.poses[11])
    wrong = Validation.of(model, [press[11]], press.obj, shifted)
    assert wrong.rms_m > 2.0 * right.rms_m
    assert wrong.patch_overlap < right.patch_overlap


def test_a_failed_estimate_has_no_force(model, press):
    elsewhere = replace(press[11], depth_m=1.6 * press[11].depth_m)
    found = Validation.of(model, [elsewhere], press.obj, press.poses[11])
    assert np.isnan(found.measured_force_n).all() and np.isnan(found.patch_overlap)
    assert "estimate of these frames failed" in found.failures[-1]
    with pytest.raises(InputError, match="no frames"):
        Validation.of(model, [], press.obj, press.poses[11])


def test_mean_of_frames_omits_pixels_missing_in_most():
    depth = np.array([[[1.0, 2.0, np.nan, np.nan]], [[3.0, np.nan, np.nan, np.nan]],
                      [[5.0, 4.0, 7.0, np.nan]]], np.float32)  # fmt: skip
    frames = [Frame(k, 0.0, image, gas_pressure_pa=1e5 + k) for k, image in enumerate(depth)]
    mean = mean_frame(frames)
    np.testing.assert_allclose(mean.depth_m, [[3.0, 3.0, np.nan, np.nan]])
    assert mean.gas_pressure_pa == pytest.approx(1e5 + 1.0)
    assert mean_frame([*frames, Frame(3, 0.0, depth[0])]).gas_pressure_pa is None


def test_rubber_is_predicted_as_rubber(model):
    """Constant tension predicts another force of the same press."""
    rubber = changed(model.sensor, membrane={"prestretch": 1.3})
    ball, pose = load_object("sphere"), np.eye(4)
    pose[2, 3] = touching_height(ball, pose, model.mesh) - 0.016
    source = SyntheticSource(rubber, ball, pose[None], nodes=1000)
    truth, frames = source.truth(0).force_n, [source[0]]

    def error(sensor):
        found = Validation.of(SensorModel.of(sensor), frames, ball, pose)
        return np.linalg.norm(found.predicted_force_n - truth) / np.linalg.norm(truth)

    assert error(rubber) < 0.05
    assert error(model.sensor) > 0.1
