"""Errors of the depth image that are known from frames without contact."""

import re
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import chdtri

import bubbleviz as bv
from bubbleviz.camera import SHIFTS, DepthCamera
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import build_mesh
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import HeldFrames
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import DepthNoise, touching_height
from bubbleviz.zeros import zeros_of
from tests.small_press import HeldPress, changed, rubber_dome

REST, HELD = 20, 4
SEEDS = range(4)


def pressed(sensor, depths_m, noise_relative=0.0, seed=0):
    """Simulation of a ball that is pressed in by so much."""
    ball, poses = load_object("sphere"), np.tile(np.eye(4), (len(depths_m), 1, 1))
    poses[:, 2, 3] = touching_height(ball, poses[0], build_mesh(rubber_dome())) - np.array(depths_m)
    return HeldPress(sensor, ball, poses, DepthNoise(relative=noise_relative), seed=seed)


@cache
def shown():
    """The membrane at rest and with a ball in it, without noise; the ball's force."""
    simulation = pressed(rubber_dome(), (-0.02, 0.006))
    return [simulation[0], simulation[1]], simulation.truth(1).force_n


@cache
def press(seed):
    """Frames without contact, then of a ball that is held, at 1 % of noise; and its force."""
    camera, noise, frames = DepthCamera.of(rubber_dome().camera), DepthNoise(relative=0.01), []
    exact, force_n = shown()
    for k in range(REST + HELD):
        frame = exact[int(k >= REST)]
        depth = camera.depth_image(noise.apply(camera.range_image(frame.depth_m), seed, k))
        noisy = {"index": k, "time_s": k / 30.0, "depth_m": depth.astype(np.float32)}
        frames.append(replace(frame, **noisy))
    return frames, force_n


def shifted(frame, offset_m, scale=0.0):
    depth_m = (frame.depth_m * np.float32(1.0 + scale) + np.float32(offset_m)).astype(np.float32)
    return replace(frame, depth_m=depth_m, gas_pressure_pa=None)


@cache
def pipeline():
    return Pipeline.of(rubber_dome())


@cache
def estimator():
    return bv.Estimator(rubber_dome())


def streamed(frames):
    """Results of the frames of a stream."""
    estimator().reset()
    return [estimator().update(frame) for frame in frames]


def solved(frames):
    """Results of the last frames."""
    return streamed(frames)[-HELD:]


def errors(frames, force_n):
    """Errors of the force in the last frames, N."""
    found = solved(frames)
    assert {each.status for each in found} == {"ok"}
    return [np.linalg.norm(each.force_n - force_n) for each in found]


@pytest.mark.long  # in short: below
def test_frames_without_contact_make_the_force_more_accurate():
    with_rest, alone = [], []
    for seed in SEEDS:
        frames, force_n = press(seed)
        with_rest += errors(frames, force_n)
        alone += errors(frames[REST:], force_n)
    assert np.sqrt(np.mean(np.square(with_rest))) < 0.95 * np.sqrt(np.mean(np.square(alone)))


@pytest.mark.parametrize("scale", [-2e-3, 2e-3])
def test_a_camera_that_has_changed_since_calibration(scale):
    """Alone, without the frames without contact, some of these are refused."""
    frames, force_n = press(1)
    error = errors([shifted(frame, 3e-4, scale) for frame in frames], force_n)
    assert max(error) < 0.06 * np.linalg.norm(force_n)


@pytest.mark.parametrize("offset_m", [-5e-4, pytest.param(5e-4, marks=pytest.mark.long)])
def test_a_camera_that_moves_during_contact(offset_m):
    """What was known of its images does not count any more: it would make the force wrong."""
    frames, _ = press(0)
    moved = [shifted(frame, offset_m * (k >= REST)) for k, frame in enumerate(frames)]
    for found, alone in zip(solved(moved), solved(moved[REST:]), strict=True):
        assert found.status == alone.status
        # each has converged to a tenth of σ; ways to one frame agree within a quarter
        assert (np.abs(found.force_n - alone.force_n) <= 0.25 * alone.force_sigma_n).all()


@pytest.mark.parametrize("offset_m", [-5e-4, 5e-4])
def test_a_camera_that_moves_is_not_contact(offset_m):
    frames = [shifted(frame, offset_m * (k >= 17)) for k, frame in enumerate(press(0)[0][:REST])]
    assert {each.status for each in streamed(frames)} == {"no_contact"}


@pytest.mark.parametrize(
    "shift_m", [(1e-3, 0.0, 0.0), pytest.param((0.0, -1e-3, 0.0), marks=pytest.mark.long)]
)
def test_a_camera_that_was_moved_across_its_axis_since_the_calibration(shift_m):
    """Else it looks like contact in the frames without any, and like friction in the others."""
    position_m = np.add(rubber_dome().camera.position_m, shift_m)
    moved = changed(rubber_dome(), camera={"position_m": tuple(position_m)})
    depths_m = [-0.02] * REST + [0.006] * HELD
    simulation = pressed(moved, depths_m, noise_relative=0.01, seed=1)
    run = bv.estimate([simulation[k] for k in range(REST + HELD)], rubber_dome())
    assert [each.status for each in run] == ["no_contact"] * REST + ["ok"] * HELD
    for k in range(REST, REST + HELD):
        error = np.linalg.norm(run.force_n[k] - simulation.truth(k).force_n)
        assert error < 1.3 * run[k].estimate.force_half_width_n
        found = run[k].estimate.image_errors
        off_m, covariance = found.mean[SHIFTS] - shift_m[:2], found.covariance + found.by_model
        assert off_m @ np.linalg.solve(covariance[SHIFTS, SHIFTS], off_m) < chdtri(2, 0.01)
        # errors of the model do not average out over the frames without contact
        assert np.diag(covariance)[SHIFTS].min() > 1e-4**2
    told = re.match(r"the camera has moved sideways by about (\S+) mm", run.warning)
    assert float(told[1]) == pytest.approx(1.0, abs=0.11)


def test_an_image_that_jumps_as_a_press_begins_is_not_noisy():
    """Changes of the frames after it, in which the press goes on, are not noise either."""
    sensor = changed(rubber_dome(), camera={"noise_relative": 0.002})
    simulation = pressed(
        sensor, [-0.02] * 5 + [2e-3, 4e-3, 6e-3, 8e-3], noise_relative=0.002, seed=1
    )
    frames = [simulation[k] for k in range(9)]
    jumped = [replace(each, depth_m=np.roll(each.depth_m, -1, axis=1)) for each in frames[5:]]
    zeros = zeros_of(HeldFrames([*frames[:5], *jumped]), Pipeline.of(sensor))
    assert zeros.image.noise == 1.0


@pytest.mark.parametrize("returns", [False, True])
def test_a_drift_of_the_camera_outlasts_the_contact(returns):
    """What ends with the contact is an error of the membrane's model."""
    frames, _ = press(0)
    after = [replace(frames[k], index=k + 24, time_s=(k + 24) / 30.0) for k in range(5)]
    offset_m = [0.0] * REST + [1e-3] * HELD + [0.0 if returns else 1e-3] * len(after)
    moved = [
        replace(frame, depth_m=frame.depth_m + np.float32(offset))
        for frame, offset in zip([*frames, *after], offset_m, strict=True)
    ]
    warning = bv.estimate(moved, rubber_dome()).warning
    assert f"{HELD} frames with contact contradicts depth" in warning
    assert "shape or rubber of the membrane differ from the sensor file" in warning
    assert ("Let the camera warm up" in warning) is not returns


def test_a_recording_and_its_frames_one_by_one_have_the_same_force():
    frames, _ = press(0)
    run = bv.estimate(frames, rubber_dome())
    for found, force_n in zip(streamed(frames), run.force_n, strict=True):
        size = np.linalg.norm(force_n)
        assert found.force_n == pytest.approx(force_n, abs=0.01 * max(size, 1e-9))


def test_frames_of_a_short_recording_are_searched_for_contact_once():
    (frames, _), read = press(0), Counter[int]()

    class Read(HeldFrames):
        def __getitem__(self, index):
            read[index] += 1
            return super().__getitem__(index)

    zeros_of(Read(frames[REST - 6 :]), pipeline())
    assert max(read.values()) <= 3  # twice as a neighbour of others


def test_a_short_rest_between_contacts_is_found():
    frames, _ = press(0)
    touched = frames[-5:]
    zeros = zeros_of(HeldFrames([*touched, *frames[:4], *touched]), pipeline())
    assert zeros.applied(touched[0]).image_errors is not None


@pytest.mark.parametrize("options", [EstimatorOptions(image_error=0.0), EstimatorOptions("paper")])
def test_estimators_without_image_errors_know_none(options):
    frames, _ = press(0)
    zeros = zeros_of(HeldFrames(frames), Pipeline.of(rubber_dome(), options=options))
    assert zeros.applied(frames[REST]).image_errors is None


@pytest.mark.parametrize("noise", [1.0, 2.0])
def test_frames_without_contact_of_a_noisier_camera(noise):
    """Its images tell less; what is known of them contains the truth."""
    (frames, _), rng = press(0), np.random.default_rng(0)
    rest = [
        replace(f, depth_m=(f.depth_m + noise * 1e-3 * rng.normal(size=f.depth_m.shape)))
        for f in frames[:15]
    ]
    zeros = zeros_of(HeldFrames(rest), pipeline())
    known = zeros.applied(frames[REST]).image_errors
    size = np.diag(pipeline().estimator.image_priors[1].covariance)
    assert (np.linalg.eigvalsh(known.covariance / np.sqrt(np.outer(size, size))) > 0.0).all()
    assert (np.diag(known.covariance) < 1.05 * size).all()
    assert (np.abs(known.mean) < 4.0 * np.sqrt(np.diag(known.covariance))).all()
