"""Depth in whole millimetres, as most cameras record it, with less noise than that."""

import numpy as np
import pytest

from bubbleviz.camera import PixelModel, RangeObserver
from bubbleviz.membrane import mesh_cap, spherical_cap
from tests.inverse.test_rubber_estimator import CAMERA, A, H, depth_image_of, estimator, pressed

NOISE_M = 1e-4


def rounded(mesh, motion, seed=0):
    return np.round(depth_image_of(mesh, motion, NOISE_M, seed=seed), 3)


@pytest.fixture(scope="module")
def solver():
    return estimator(1000, relative=NOISE_M / 0.065)


@pytest.mark.parametrize(("depth", "x"), [(0.0008, 0.0), (0.001, 0.008), (0.003, 0.0)])
def test_force_from_depth_in_whole_millimetres_is_in_its_interval(solver, depth, x):
    mesh, contact = pressed("sphere", depth, x)
    truth = contact.nodal_force_n.sum(axis=0)
    estimate, _ = solver.estimate(rounded(mesh, contact.displacement_3d_m))
    assert estimate.status == "ok"
    assert (np.abs(estimate.force_n - truth) < 1.96 * estimate.force_sigma_n).all()


def test_noise_in_a_pixels_file_includes_that_of_rounding():
    """So rounding errors are as similar in neighbouring blocks as without a pixels file."""
    mesh = mesh_cap(spherical_cap(A, H), 1000)
    image = rounded(mesh, np.zeros_like(mesh.nodes))
    told = np.full(image.shape, np.hypot(NOISE_M, 1e-3 / np.sqrt(12.0)))
    pixels = PixelModel(np.isfinite(image), np.zeros_like(told), told)
    with_file, without = (
        RangeObserver(CAMERA, mesh, NOISE_M / 0.065, each, block=3) for each in (pixels, None)
    )
    found, known = (np.mean(each.measure(image).rounding_m2) for each in (with_file, without))
    assert found == pytest.approx(known, rel=0.2) and known > 1e-8


def test_rounding_is_not_contact(solver):
    mesh, _ = pressed("sphere", 0.007)
    for seed in range(3):
        estimate, _ = solver.estimate(rounded(mesh, np.zeros_like(mesh.nodes), seed))
        assert estimate.status == "no_contact"
        assert not estimate.force_n.any()


def test_rounding_that_noise_averages_out_changes_nothing():
    """Noise of half a millimetre; the estimate as well as its interval."""
    solver, (mesh, contact) = estimator(relative=5e-4 / 0.065), pressed("sphere", 0.007)
    image = depth_image_of(mesh, contact.displacement_3d_m, 5e-4)
    exact, found = (solver.estimate(each)[0] for each in (image, np.round(image, 3)))
    size = np.linalg.norm(exact.force_n)
    assert np.linalg.norm(found.force_n - exact.force_n) < 0.02 * size
    np.testing.assert_allclose(found.force_sigma_n, exact.force_sigma_n, rtol=0.2)
