"""Noise that is correlated between pixels, which the sensor file does not tell."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import chdtri

import bubbleviz as bv
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import HeldFrames
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import touching_height
from bubbleviz.zeros import zeros_of
from tests.inverse.conftest import dome_images
from tests.rubber_renders import rubber_truth
from tests.small_press import changed, rubber_dome

REST, RELATIVE, WIDTH_PX = 20, 0.01, 2.0
DEPTHS_M = 0.006, 0.010, 0.014


@cache
def pipeline(relative=RELATIVE):
    """Of a camera whose sensor file declares so much noise."""
    return Pipeline.of(changed(rubber_dome(), camera={"noise_relative": relative}))


@cache
def exact():
    """The membrane at rest and pressed by a ball ever deeper, without noise; the ball's forces."""
    poses = np.tile(np.eye(4), (1 + len(DEPTHS_M), 1, 1))
    top = touching_height(load_object("sphere"), poses[0], pipeline().mesh)
    poses[:, 2, 3] = top - np.array([-0.02, *DEPTHS_M])
    simulation = bv.simulate(rubber_dome(), "sphere", poses)
    return list(simulation), [simulation.truth(k).force_n for k in range(1, len(poses))]


def noisy(frame, k, width_px=WIDTH_PX, relative=RELATIVE):
    """An image with noise of the standard deviation in the sensor file."""
    noise = np.random.default_rng(k).standard_normal(frame.depth_m.shape)
    return with_noise(frame, k, noise, width_px, relative)


def with_noise(frame, k, noise, width_px, relative):
    """The same of given white noise."""
    if width_px:
        noise = gaussian_filter(noise, width_px)
    depth_m = frame.depth_m * np.float32(1.0 + relative * noise / noise.std())
    return replace(frame, index=k, time_s=k / 30.0, depth_m=depth_m.astype(np.float32))


def correlated_in_time(frame, count, seed):
    """Images whose noise has a correlation of 0.8 to the power of the frames between them."""
    random, kept, frames = np.random.default_rng(seed), 0.8, []
    noise = random.standard_normal(frame.depth_m.shape)
    for k in range(count):
        new = random.standard_normal(noise.shape)
        noise = kept * noise + np.sqrt(1.0 - kept**2) * new
        frames.append(with_noise(frame, k, noise, WIDTH_PX, RELATIVE))
    return frames


def recording(width_px=WIDTH_PX):
    """Frames without contact, then one of each press; and their forces."""
    (rest, *pressed), forces = exact()
    frames = [rest] * REST + pressed
    return [noisy(frame, k, width_px) for k, frame in enumerate(frames)], np.array(forces)


def test_frames_of_a_recording_without_contact_have_none():
    frames, forces = recording()
    run = bv.estimate(frames, rubber_dome())
    assert set(run.status[:REST]) == {"no_contact"}
    assert set(run.status[REST:]) == {"ok"}
    assert run.warning is not None and " times the noise of the sensor file" in run.warning
    sigma_n = run.table()[[f"force_sigma_{axis}_n" for axis in "xyz"]].to_numpy()[REST:]
    inside = np.abs(run.force_n[REST:] - forces) <= 1.96 * sigma_n
    assert np.count_nonzero(inside) >= 8  # of 9 components


def test_noise_that_is_correlated_in_time_is_no_contact():
    """The images at the start then tell less of the errors of later ones than their number says."""
    run = bv.estimate(correlated_in_time(exact()[0][0], 100, 5), rubber_dome())
    assert np.count_nonzero(run.status == "no_contact") >= 99


def test_errors_known_from_rest_contain_the_truth_where_noise_is_correlated_in_time():
    """Together they tell as much as 1.7 independent ones."""
    rest, squares = exact()[0][0], 0.0
    for seed in range(3):
        frames = correlated_in_time(rest, 15, seed)
        zeros = zeros_of(HeldFrames(frames), pipeline())
        known = zeros.applied(frames[-1]).image_errors
        squares += known.mean @ np.linalg.solve(known.covariance, known.mean)
    assert squares < chdtri(3 * len(known.mean), 0.01)


def test_later_frames_of_a_stream_without_contact_have_none():
    estimator, rest = bv.Estimator(rubber_dome()), exact()[0][0]
    found = [estimator.update(noisy(rest, k)).status for k in range(100, 200)]
    assert found[REST:].count("no_contact") >= 99 - REST  # false ones are rare


@pytest.mark.parametrize("width_px", [0.0, WIDTH_PX])
def test_the_noise_of_a_recording(width_px):
    """Independent samples of filtered noise are as large as 4π widths squared."""
    zeros = zeros_of(HeldFrames(recording(width_px)[0]), pipeline())
    expected = max(1.0, np.sqrt(4.0 * np.pi) * width_px)
    assert zeros.applied(exact()[0][0]).noise == pytest.approx(expected, rel=0.3)


def test_presses_are_no_noise():
    """They change an image smoothly, not as noise does."""
    rest, *pressed = exact()[0]
    frames = [noisy(frame, k, 0.0, 0.1 * RELATIVE) for k, frame in enumerate([rest] * 10 + pressed)]
    assert zeros_of(HeldFrames(frames), pipeline(0.1 * RELATIVE)).gas.frames == 10


@pytest.mark.long  # in short: above
def test_deep_presses_that_differ_in_all_frames_are_no_noise():
    camera = {"width": 160, "height": 120, "fx": 112.0, "fy": 112.0, "cx": 79.5, "cy": 59.5}
    camera |= {"position_m": (0.0, 0.0, -0.062), "noise_relative": 0.0015}
    membrane = {"rim_radius_m": 0.04, "height_m": 0.028, "nodes": 400}
    steep = changed(rubber_dome(), membrane=membrane, camera=camera)
    poses, turn = np.tile(np.eye(4), (6, 1, 1)), 4.0 * np.pi / 5.0 * np.arange(5)
    poses[1:, 0, 3], poses[1:, 1, 3] = 0.01 * np.cos(turn), 0.01 * np.sin(turn)
    poses[:, 2, 3] = [0.06, 0.014, 0.0085, 0.0115, 0.010, 0.013]  # of the ball's lowest point
    press = bv.simulate(steep, "sphere", poses, noise_relative=0.0015)
    run = bv.estimate(list(press), steep)
    assert run.status.tolist() == ["no_contact"] + 5 * ["ok"]
    forces = [press.truth(k).force_n for k in range(6)]
    assert run.force_n == pytest.approx(np.array(forces), abs=0.1)


@pytest.mark.long  # in short: above
def test_presses_alone_are_no_noise_though_the_camera_has_changed(identified):
    """Another solver's dome; each frame is pressed, and fits noise as well as contact."""
    truth = rubber_truth("dome_ball")
    presses = dome_images(truth, truth["nodes_m"], truth["gauge_pressure_pa"], noise_m=1e-4)
    frames = [replace(each, depth_m=each.depth_m - np.float32(5e-4)) for each in presses]
    run = bv.estimate(frames, identified)
    assert set(run.status) == {"ok"}
    off_n = np.linalg.norm(run.force_n - truth["force_n"], axis=1)
    assert np.all(off_n < 0.03 * np.linalg.norm(truth["force_n"], axis=1))


@pytest.mark.parametrize(("step_share", "zeroed"), [(-0.005, True), (0.02, False)])
def test_images_like_noise_are_no_rest_while_the_gas_pressure_rises(step_share, zeroed):
    """By a share of the gauge pressure a frame: of a leak, it is small while two are compared."""
    rest = exact()[0][0]
    pressure, gauge = rest.gas_pressure_pa, rubber_dome().pneumatics.gauge_pressure_pa
    frames = [
        replace(noisy(rest, k), gas_pressure_pa=pressure + step_share * gauge * k)
        for k in range(REST)
    ]
    zeros = zeros_of(HeldFrames(frames), pipeline(0.1 * RELATIVE))
    assert (zeros.gas.offset_pa is not None) is zeroed
