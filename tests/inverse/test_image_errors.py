"""Systematic errors of depth images: warm cameras, moved mountings."""

import numpy as np
import pytest
from scipy.special import chdtri

from bubbleviz.camera import (
    IMAGE_ERRORS,
    SHIFTS,
    DepthCamera,
    ImageErrors,
    MembraneView,
    PixelModel,
    RangeObserver,
)
from bubbleviz.inverse import Estimator
from bubbleviz.pipeline import Pipeline
from bubbleviz.sensor import load_sensor
from tests.inverse.test_rubber_estimator import CAMERA, NOISE_M, depth_image_of, estimator, pressed

ROWS, COLUMNS = np.indices((CAMERA.intrinsics.height, CAMERA.intrinsics.width))
RIGHT = (COLUMNS - CAMERA.intrinsics.cx) / CAMERA.intrinsics.fx
DOWN = (ROWS - CAMERA.intrinsics.cy) / CAMERA.intrinsics.fy
ERRORS = {
    "offset": lambda depth, size: depth + size,
    "tilt to the right": lambda depth, size: depth + size * RIGHT,
    "tilt downwards": lambda depth, size: depth + size * DOWN,
    "scale": lambda depth, size: depth * (1.0 + size),
}
OFF = [
    ("offset", -5e-4),
    ("offset", 1e-3),
    ("tilt to the right", 1e-3),
    ("tilt downwards", -1e-3),
    ("scale", -0.01),
    ("scale", 0.01),
]


@pytest.fixture(scope="module")
def solver():
    return estimator()


@pytest.mark.parametrize(("kind", "size"), OFF)
def test_image_errors_are_not_contact(solver, kind, size):
    mesh, _ = pressed("sphere", 0.007, 0.0)
    image = ERRORS[kind](depth_image_of(mesh, np.zeros_like(mesh.nodes), NOISE_M), size)
    estimate, _ = solver.estimate(image)
    assert estimate.status == "no_contact"
    assert not estimate.force_n.any()
    assert estimate.residual_rms_m < NOISE_M
    if kind != "scale":  # which an offset resembles
        found = estimate.image_errors.mean[IMAGE_ERRORS.index(kind)]
        assert found == pytest.approx(size, rel=0.3)


@pytest.mark.parametrize(("kind", "size"), OFF)
def test_force_of_a_press_with_image_errors(solver, kind, size):
    mesh, contact = pressed("sphere", 0.007, 0.0)
    truth = contact.nodal_force_n.sum(axis=0)
    image = ERRORS[kind](depth_image_of(mesh, contact.displacement_3d_m, NOISE_M), size)
    estimate, _ = solver.estimate(image)
    assert estimate.status == "ok"
    assert np.linalg.norm(estimate.force_n - truth) < 0.06 * np.linalg.norm(truth)
    assert (np.abs(estimate.force_n - truth) < 1.96 * estimate.force_sigma_n).all()


@pytest.mark.parametrize(
    ("press", "shift_m", "seed"),
    [
        (("cylinder", 0.005, 0.0), (1e-3, 0.0, 0.0), 0),
        (("cylinder", 0.005, 0.0), (0.0, -2e-3, 0.0), 0),
        # friction and noise fit this one, too
        (("sphere", 0.007, 0.008), (0.0, -1e-3, 0.0), 1),
    ],
)
def test_a_camera_that_was_moved_is_neither_contact_nor_friction(solver, press, shift_m, seed):
    """Its motion is found, within its uncertainty, and place and force of the contact are right."""
    T_B_C = CAMERA.T_B_C.copy()
    T_B_C[:3, 3] += T_B_C[:3, :3] @ shift_m
    camera, (mesh, contact) = DepthCamera(CAMERA.intrinsics, T_B_C), pressed(*press)
    noise_m, images = NOISE_M * np.random.default_rng(seed).standard_normal(ROWS.shape), []
    for motion in (np.zeros_like(mesh.nodes), contact.displacement_3d_m):
        images.append(camera.depth_image(MembraneView(camera, mesh).range_image(motion) + noise_m))
    loads = np.linalg.norm(contact.nodal_force_n, axis=1)
    true = np.average(mesh.deformed(contact.displacement_3d_m), axis=0, weights=loads)
    rest, _ = solver.estimate(images[0])
    assert rest.status == "no_contact"
    for known in (None, rest.image_errors):
        estimate, _ = solver.estimate(images[1], image_errors=known)
        error = np.linalg.norm(estimate.force_n - contact.nodal_force_n.sum(axis=0))
        assert error < estimate.force_half_width_n
        found = estimate.image_errors
        assert found.mean[SHIFTS] == pytest.approx(shift_m[:2], abs=3e-4)
        off_m, covariance = found.mean[SHIFTS] - shift_m[:2], found.covariance + found.by_model
        assert off_m @ np.linalg.solve(covariance[SHIFTS, SHIFTS], off_m) < chdtri(2, 0.05)
        weights = solver.mesh.areas * estimate.contact_pressure_pa
        center = np.average(solver.mesh.deformed(estimate.motion_m), axis=0, weights=weights)
        assert np.linalg.norm(center[:2] - true[:2]) < 0.3 * np.linalg.norm(shift_m)
        view = MembraneView(CAMERA, solver.mesh)
        off_m = CAMERA.range_image(images[1]) - view.range_image(view.motion_seen(estimate))
        assert np.nanpercentile(np.abs(off_m), 99) < 4.0 * NOISE_M


def test_noise_factor_is_that_of_the_image(solver):
    mesh, contact = pressed("sphere", 0.007, 0.008)
    image = depth_image_of(mesh, contact.displacement_3d_m, 3.0 * NOISE_M)
    assert solver.estimate(image)[0].noise_factor == pytest.approx(3.0, rel=0.25)


def test_a_known_error_that_has_gone_is_no_motion_of_the_camera(solver):
    drift = solver.image_priors[0]
    known = ImageErrors(np.array([3e-4, 0.0, 0.0, 0.0, 0.0, 0.0]), 0.01 * drift.covariance)
    mesh, contact = pressed("cylinder", 0.005, 0.0)
    image = depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    estimate, _ = solver.estimate(image, image_errors=known)
    assert np.abs(estimate.image_errors.mean[SHIFTS]).max() < 3e-5


def test_a_contact_over_most_of_the_image_has_the_same_solution_warm_and_cold(solver):
    mesh, contact = pressed("sphere", 0.007, 0.0)
    image = depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    half = np.where(CAMERA.intrinsics.cx < COLUMNS, np.nan, image)
    _, start = solver.estimate(image)
    followed, _ = solver.estimate(half, start=start)
    alone, _ = solver.estimate(half)
    assert alone.status == "ok"
    assert followed.image_errors is alone.image_errors is None  # those of the rest are unknown
    assert followed.force_n == pytest.approx(
        alone.force_n, abs=0.01 * np.linalg.norm(alone.force_n)
    )


def seen(depth_m, x):
    """Images of a ball's press and at rest, its force, and the pixels' way from the middle."""
    mesh, contact = pressed("sphere", depth_m, x)
    image = depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    rest = depth_image_of(mesh, np.zeros_like(mesh.nodes), NOISE_M)
    row, column = np.unravel_index(np.nanargmax(rest - image), image.shape)
    return image, rest, contact.nodal_force_n.sum(axis=0), (ROWS - row, COLUMNS - column)


def test_a_hole_in_a_contact_lowers_the_seen_share(solver):
    image, rest, _, way = seen(0.007, 0.0)
    whole, _ = solver.estimate(image)
    assert whole.seen_share == pytest.approx(1.0)
    hole = np.hypot(*way) < 0.08 * image.shape[1]
    part, _ = solver.estimate(np.where(hole, np.nan, image))
    assert 0.8 < part.seen_share < 1.0
    assert np.isnan(solver.estimate(rest)[0].seen_share)


@pytest.mark.parametrize("object_seen", ["hand", "cable"])
def test_an_image_with_a_region_that_is_not_membrane_is_refused(solver, object_seen):
    """A hand 30 mm from the camera, beside the press; a cable there has little weight."""
    image, _, truth, (down, right) = seen(0.007, 0.008)
    right = right + 25
    hidden = np.hypot(down, right) < 14 if object_seen == "hand" else np.abs(right) < 2
    estimate, _ = solver.estimate(np.where(hidden, 0.03, image))
    if object_seen == "hand":
        assert estimate.status == "implausible"
        assert "object" in estimate.reason
    else:
        error = np.linalg.norm(estimate.force_n - truth)
        assert estimate.status == "ok"
        assert error < estimate.force_half_width_n


@pytest.mark.parametrize(("radius", "bias_m"), [(0.05, 0.0), (0.05, -5e-4), (0.08, 1e-3)])
def test_returns_biased_beside_a_specular_spot_leave_the_force_in_its_interval(
    solver, radius, bias_m
):
    """The spot, without returns, is in the contact; the ring around it is 2 mm wide."""
    image, _, truth, way = seen(0.004, 0.008)
    away = np.hypot(*way) / image.shape[1]
    ring = (radius <= away) & (away < radius + 0.028)
    estimate, _ = solver.estimate(np.where(away < radius, np.nan, image + bias_m * ring))
    error = np.abs(estimate.force_n - truth)
    assert (error < 1.96 * estimate.force_sigma_n).all()
    assert np.linalg.norm(error) < 0.02 * np.linalg.norm(estimate.force_n)


@pytest.mark.parametrize("bias_m", [0.0, 5e-4, -1e-3])
def test_a_specular_spot_of_the_identification_may_have_another_border_in_a_press(solver, bias_m):
    """Its pixels are masked; here all of them have returns, those beside the mask biased ones."""
    image, _, truth, way = seen(0.004, 0.008)
    away = np.hypot(*way) / image.shape[1]
    pixels = PixelModel(away >= 0.06, np.zeros_like(away), np.full(away.shape, NOISE_M))
    observer = RangeObserver(CAMERA, solver.mesh, NOISE_M / 0.065, pixels, block=3)
    estimate, _ = Estimator(observer, solver.bubble).estimate(image + bias_m * (away < 0.088))
    error = np.abs(estimate.force_n - truth)
    assert (error < 1.96 * estimate.force_sigma_n).all()
    assert np.linalg.norm(error) < 0.05 * np.linalg.norm(estimate.force_n)


def test_a_surface_far_outside_the_membrane_is_refused_without_a_solve(solver):
    """A camera turned in its mount measures points where the membrane cannot be."""
    mesh, _ = pressed("sphere", 0.007, 0.0)
    image = depth_image_of(mesh, np.zeros_like(mesh.nodes), NOISE_M) + np.where(
        RIGHT > 0.0, 0.02, -0.02
    )
    estimate, _ = solver.estimate(image)
    assert estimate.status == "implausible"
    assert estimate.solve_ms == 0.0


@pytest.fixture(scope="module")
def usual(solver):
    """Image of a press, and its estimate."""
    mesh, contact = pressed("sphere", 0.007, 0.0)
    image = depth_image_of(mesh, contact.displacement_3d_m, NOISE_M)
    return image, solver.estimate(image)[0]


@pytest.mark.parametrize("value_m", [1e-3, 0.04, 12.0])
@pytest.mark.parametrize("right_m", [0.008, -0.02])
def test_one_bad_pixel_changes_nothing(solver, usual, value_m, right_m):
    """Inside and outside the contact."""
    image, usual = usual[0].copy(), usual[1]
    image.flat[np.argmin(np.hypot(RIGHT * image - right_m, DOWN * image))] = value_m
    estimate, _ = solver.estimate(image)
    assert estimate.status == "ok"
    size = np.linalg.norm(usual.force_n)
    assert np.linalg.norm(estimate.force_n - usual.force_n) < 0.01 * size
    touching = estimate.contact_pressure_pa > 0.0
    assert np.count_nonzero(touching != (usual.contact_pressure_pa > 0.0)) <= 1


def test_an_image_of_no_membrane_is_refused_after_a_few_steps(monkeypatch):
    """Each step costs a new tangent, and as many responses as nodes are selected."""
    pipeline, count = Pipeline.of(load_sensor("punyo_oval_d405")), 0
    bubble = pipeline.estimator.bubble
    linearised, size = bubble.linearised, (480, 640)

    def counted(*given):
        nonlocal count
        count += 1
        return linearised(*given)

    monkeypatch.setattr(bubble, "linearised", counted)
    estimate, _ = pipeline.estimator.estimate(np.full(size, 0.06, np.float32))
    assert estimate.status == "implausible"
    assert count <= 8
