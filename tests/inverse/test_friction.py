"""Friction from depth alone, on rubber of another solver and presses on another mesh."""

import re

import numpy as np
import pytest
import trimesh

import bubbleviz as bv
from bubbleviz.inverse import EstimatorOptions, friction_loads, prior_scale
from bubbleviz.membrane import mesh_cap, spherical_cap
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.simulation import DepthNoise
from tests.inverse.conftest import dome_images
from tests.membrane.domes import pose
from tests.oracles.flow_sighting import sighting
from tests.oracles.stuck_press import Motion
from tests.rubber_renders import rubber_truth
from tests.shear.drag import FLOW_PX, Eyes, press, sensor, stuck

PRODUCTS = frozenset({"patch"})
DOME = mesh_cap(spherical_cap(0.045, 0.02), 800)


def loads_of(pressure):
    return friction_loads(DOME.nodes, DOME.areas[:, None] * DOME.normals, pressure, DOME.rings)


def on(x, y, radius=0.008):
    away = np.hypot(DOME.nodes[:, 0] - x, DOME.nodes[:, 1] - y)
    return np.where(away < radius, 3000.0, 0.0)


def test_friction_modes_are_two_translations_and_a_rotation_per_contact():
    one, other = on(0.0, 0.0), on(0.03, 0.01, 0.006)
    loads = loads_of(one + other)
    assert loads.shape == (len(DOME.nodes), 3, 6)
    along_normal = np.einsum("ni,nij->nj", DOME.normals, loads)
    assert np.abs(along_normal).max() < 1e-12 * np.abs(loads).max()
    assert not loads[one == 0.0][:, :, :3].any() or not loads[other == 0.0][:, :, :3].any()
    first = loads_of(one)
    slides, spin = first[:, :, :2].sum(axis=0), first[:, :, 2]
    load = DOME.areas @ one
    np.testing.assert_allclose(slides.T @ slides, load**2 * np.eye(2), atol=0.03 * load**2)
    assert np.linalg.norm(spin.sum(axis=0)) < 0.02 * load
    torque = np.cross(DOME.nodes, spin).sum(axis=0)
    assert abs(torque[2]) > 0.5 * load * 0.008 / np.sqrt(2.0)
    assert np.hypot(*torque[:2]) < 0.05 * abs(torque[2])


def test_contact_of_one_node_has_no_rotation_mode():
    pressure = np.zeros(len(DOME.nodes))
    pressure[np.argmin(np.hypot(DOME.nodes[:, 0], DOME.nodes[:, 1]))] = 1e4
    loads = loads_of(pressure)
    assert np.isfinite(loads).all()
    assert loads[:, :, :2].any()
    assert not loads[:, :, 2].any()


def test_prior_of_friction_is_as_wide_as_the_frame_says():
    """Amplitudes drawn as assumed: smaller errors than with a wide prior, and honest intervals."""
    random, noise, variance = np.random.default_rng(4), 0.05, 0.05**2
    inside, errors, wide_errors = 0, [], []
    for number in range(600):
        size = 0.0 if number % 2 else 10.0 ** random.uniform(-2.0, 0.0)
        true = size * random.standard_normal(2)
        measured, scale = true + noise * random.standard_normal(2), 1.0
        for _ in range(20):
            share = scale**2 / (scale**2 + variance)
            covariance = share * variance * np.eye(2)
            found = prior_scale(share * measured, covariance, 1.0, scale)
            if found.value == scale:
                break
            scale = found.value
        error = share * measured - true
        inside += error @ np.linalg.solve(covariance + found.spread, error) < 5.99
        errors.append(error)
        wide_errors.append(measured / (1.0 + variance) - true)
    assert found.value == scale and 0.94 < inside / 600 < 0.99
    assert np.square(errors).sum() < 0.6 * np.square(wide_errors).sum()


def test_noise_is_not_taken_for_friction():
    """Presses without friction at 1 % of noise; the ground truth is on a separate mesh."""
    truth, eyes = press("sphere", 0.004)[0].moved(Motion(np.zeros(3))), Eyes()
    errors = []
    for seed in range(6):
        seen = sighting(eyes.pipeline.camera, truth, DepthNoise(relative=0.01), FLOW_PX, seed)
        eyes.pipeline.restart()
        found = eyes.pipeline.estimate_once(Frame(seed, seed / 30.0, seen.depth_m))
        errors.append(np.linalg.norm(found.force_n - truth.force_n))
    assert np.median(errors) < 0.02 * np.linalg.norm(truth.force_n)


def test_friction_of_a_sticking_object_that_is_dragged():
    """The ground truth is on a separate mesh, with friction not proportional to pressure."""
    truth, eyes = stuck("puck", 0.004, 0.001, 8.0), Eyes()
    frame, size = eyes.see(truth), np.linalg.norm(truth.force_n)
    result = eyes.pipeline.process(frame, PRODUCTS)
    estimate, center = result.estimate, result.patch.center_of_pressure_m
    error = estimate.force_n - truth.force_n
    assert np.linalg.norm(error) < 0.05 * size
    assert (np.abs(error) < 1.96 * estimate.force_sigma_n).all()
    off = np.abs(result.patch.torque_nm - truth.torque_nm(center))
    assert (off < 1.96 * estimate.torque_sigma_about(center)).all()
    np.testing.assert_allclose(estimate.force_n, estimate.nodal_force_n.sum(axis=0))
    frictionless = Pipeline.of(sensor(), options=EstimatorOptions(friction=0.0))
    without = frictionless.process(frame, PRODUCTS).estimate
    assert np.linalg.norm(without.force_n - truth.force_n) > 0.08 * size or not without.trusted


def test_more_friction_than_expected_gives_a_warning():
    eyes = Eyes()
    frames = [eyes.see(stuck("puck", 0.004, drag, 0.0)) for drag in (0.0, 0.002)]
    truth = stuck("puck", 0.004, 0.002, 0.0).force_n
    warned = bv.estimate(frames, sensor(), friction=0.2, zero_gas=False).warning
    told = re.fullmatch(
        r"friction in 1 frame is at least (\S+) of the normal force, more than the expected "
        r"coefficient of 0\.2, .* \(--friction; .*\)",
        warned,
    )
    assert 0.2 < float(told[1]) < np.linalg.norm(truth[:2]) / abs(truth[2])
    assert bv.estimate(frames, sensor(), zero_gas=False).warning is None


@pytest.mark.long  # in short: of a puck on another mesh, above
@pytest.mark.parametrize(("name", "noise_m"), [("ball_drag1", 5e-5), ("puck_twist", 1.5e-4)])
def test_friction_on_rubber_by_another_solver(name, noise_m, identified, tmp_path):
    """Dragged or twisted."""
    truth = rubber_truth(name)
    true, gauges = truth["force_n"], truth["gauge_pressure_pa"]
    presses = dome_images(truth, truth["nodes_m"], gauges, noise_m, 2)
    run = bv.estimate(list(presses), identified)
    assert all(each.status == "ok" for each in run)
    error, size = np.linalg.norm(run.force_n - true, axis=1), np.linalg.norm(true, axis=1)
    assert np.median(error / size) < 0.015
    assert (error < np.maximum(0.04 * size, 0.01)).all()  # 10 mN of the first 0.2 N
    sigma = np.array([each.result.estimate.force_sigma_n for each in run])
    inside = (np.abs(run.force_n - true) < 1.96 * sigma).all(axis=1)
    assert inside.mean() >= 0.9
    off = np.array([each.torque_nm for each in run]) - truth["torque_nm"]
    sigma = np.array([each.torque_sigma_nm for each in run])
    assert (np.abs(off) < 1.96 * sigma).all(axis=1).mean() >= 0.9
    if name == "ball_drag1":
        _assert_tracked(presses, truth["object_position_m"], identified, tmp_path)


def _assert_tracked(presses, centers_m, sensor, folder):
    """The ball is tracked while it is dragged; its rotation cannot be seen."""
    trimesh.creation.icosphere(5, 0.01).export(folder / "ball.ply")
    first = 3  # with a patch of enough points
    start = pose(*centers_m[first] + [1e-3, -1e-3, 1e-3])
    estimator = bv.Estimator(sensor, object=folder / "ball.ply", init=start)
    for k in range(first, len(centers_m)):
        found = estimator.update(presses[k]).pose
        assert found.status == "ok"
        assert np.linalg.norm(found.T_B_O[:3, 3] - centers_m[k]) < 4e-4
