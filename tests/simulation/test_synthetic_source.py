"""Synthetic frames: reproducible, with the requested noise, equal to the simulated solution."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from bubbleviz.errors import InputError
from bubbleviz.membrane import build_mesh
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import DepthNoise, SyntheticSource, default_press
from tests.small_press import changed

FLAT = np.full((120, 160), 0.15)


def poses(*depths):
    T = np.tile(np.eye(4), (len(depths), 1, 1))
    T[:, 2, 3] = 0.05 - np.array(depths)
    return T


@pytest.fixture(scope="module")
def sensor():
    sensor = load_sensor("pico_flexx_75mm")
    return changed(sensor, membrane={"nodes": 300})


@pytest.mark.parametrize("noise", [DepthNoise(relative=0.01), DepthNoise(absolute_m=0.0015)])
def test_noise_has_the_requested_standard_deviation(noise):
    error = np.stack([noise.apply(FLAT, 0, k) - FLAT for k in range(20)])
    assert error.std() == pytest.approx(0.0015, rel=0.02)
    assert abs(error.mean()) < 2e-5


def test_noise_has_the_requested_correlation():
    noise = DepthNoise(absolute_m=1e-3, correlation_px=6.0, correlation_frames=0.5)
    error = np.stack([noise.apply(FLAT, 0, k) - FLAT for k in range(60)]) / 1e-3
    assert error.std() == pytest.approx(1.0, rel=0.05)
    assert (error[:, :, 6:] * error[:, :, :-6]).mean() == pytest.approx(np.exp(-1), abs=0.05)
    assert (error[1:] * error[:-1]).mean() == pytest.approx(0.5, abs=0.05)
    assert (error[4:] * error[:-4]).mean() == pytest.approx(0.5**4, abs=0.05)


def test_holes_and_outliers_have_the_requested_fraction():
    noise = DepthNoise(holes=0.1, outliers=0.05, outlier_m=0.03)
    images = np.stack([noise.apply(FLAT, 0, k) for k in range(10)])
    assert np.isnan(images).mean() == pytest.approx(0.1, rel=0.1)
    off = np.abs(images - FLAT)
    assert np.nanmean(off > 0) == pytest.approx(0.05, rel=0.1)
    assert 0.025 < np.nanmax(off) <= 0.03


@pytest.mark.parametrize(
    "values", [{"holes": 1.0}, {"relative": -0.1}, {"absolute_m": 1.5}, {"outliers": np.nan}]
)
def test_noise_out_of_range_is_refused(values):
    with pytest.raises(InputError, match=next(iter(values))):
        DepthNoise(**values)


def test_frame_depends_on_seed_and_index_alone(sensor):
    noise = DepthNoise(relative=0.01, correlation_frames=0.5, holes=0.02)
    path = poses(0.0, 0.004, 0.008, 0.012)
    obj = load_object("sphere")
    forward = SyntheticSource(sensor, obj, path, noise, seed=5)
    backward = SyntheticSource(sensor, obj, path, noise, seed=5)
    there = [forward[k].depth_m for k in range(4)]
    back = [backward[k].depth_m for k in (3, 2, 1, 0)][::-1]
    for a, b in zip(there, back, strict=True):
        np.testing.assert_array_equal(a, b)
    other = SyntheticSource(sensor, obj, path, noise, seed=6)[2].depth_m
    assert not np.array_equal(other, there[2], equal_nan=True)


def test_depth_without_contact_equals_the_exact_sphere(sensor):
    source = SyntheticSource(sensor, load_object("sphere"), poses(-0.01))
    frame = source[0]
    assert frame.depth_m.dtype == np.float32
    rays = source.camera.directions
    centre = np.array([0.0, 0.0, 0.05 - (0.075**2 + 0.05**2) / 0.1])
    offset = source.camera.center - centre
    b = rays @ offset
    exact = -b + np.sqrt(b**2 - offset @ offset + np.linalg.norm([0.075, centre[2]]) ** 2)
    depth = exact * (rays @ source.camera.T_B_C[:3, 2])
    seen = np.isfinite(frame.depth_m.ravel())
    assert seen.mean() > 0.95
    assert np.abs(frame.depth_m.ravel()[seen] - depth[seen]).max() < 4e-4  # chords of the mesh
    truth = source.truth(0)
    assert not truth.patch_mask.any()
    assert truth.patch_area_m2 == 0.0
    assert np.isnan(truth.center_of_pressure_m).all()
    assert frame.gas_pressure_pa == pytest.approx(103910.5)


def test_ground_truth_mask_is_the_contact_of_the_ball(sensor):
    source = SyntheticSource(sensor, load_object("sphere"), poses(0.012), nodes=6000)
    truth, frame = source.truth(0), source[0]
    pixels = np.flatnonzero(truth.patch_mask)
    on = source.camera.points(frame.depth_m, pixels)
    off = source.camera.points(
        frame.depth_m, np.flatnonzero(~truth.patch_mask & np.isfinite(frame.depth_m))
    )
    centre = np.array([0.0, 0.0, 0.05 - 0.012 + 0.015])
    assert np.abs(np.linalg.norm(on - centre, axis=1) - 0.015).max() < 3e-4
    assert np.linalg.norm(off - centre, axis=1).min() > 0.015 - 3e-4
    # cells that touch in part count in part
    touching = truth.contact_pressure_pa > 0.0
    cells_m2 = source.mesh.areas[touching].sum()
    assert 0.8 * cells_m2 < truth.patch_area_m2 < 0.97 * cells_m2
    seen = np.flatnonzero(np.isfinite(frame.depth_m))
    deformed = source.mesh.deformed(truth.displacement_m)
    _, nearest = cKDTree(deformed).query(source.camera.points(frame.depth_m, seen))
    by_node = touching[nearest]
    assert not (truth.patch_mask.ravel()[seen] & ~by_node).sum() > 0.05 * by_node.sum()
    assert truth.force_n[2] < -1.0
    assert np.abs(truth.force_n[:2]).max() < 0.02 * -truth.force_n[2]
    np.testing.assert_allclose(truth.center_of_pressure_m[:2], 0.0, atol=5e-4)


def test_simulation_mesh_is_finer_than_and_different_from_the_estimators(sensor):
    source = SyntheticSource(sensor, load_object("sphere"), poses(0.0))
    own = build_mesh(sensor)
    assert len(source.mesh.nodes) == pytest.approx(4 * len(own.nodes), rel=0.05)
    shared = (np.abs(source.mesh.nodes[:, None] - own.nodes[None]).max(axis=2) < 1e-6).any(axis=1)
    assert shared.mean() < 0.05


def test_default_press_loops_with_contact_in_between(sensor):
    source = default_press(sensor, frames=30)
    assert len(source) == 30
    touching = [bool(source.truth(k).patch_mask.any()) for k in range(30)]
    assert not any(touching[:3])
    assert not any(touching[-2:])
    assert all(touching[10:22])
    with pytest.raises(IndexError):
        source[30]
    source.close()


def test_object_on_the_rim_is_refused(sensor):
    pose = poses(0.0)
    pose[0, :3, 3] = 0.075, 0.0, -0.005
    with pytest.raises(InputError, match="rim"):
        SyntheticSource(sensor, load_object("sphere"), pose)[0]
