"""Pixels to rays and back, against the published distortion formulas."""

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from bubbleviz.camera import DepthCamera, Intrinsics

D405 = (-0.0567814413, 0.0607155726, 0.000757510119, 0.00098916795, -0.0202404283)


def camera(model="none", distortion=()):
    return Intrinsics(64, 48, 43.0, 42.9, 31.4, 24.8, model, distortion)


def test_pinhole_slope_of_a_pixel():
    slopes = camera().slopes()
    assert slopes[10, 50] == pytest.approx([(50 - 31.4) / 43.0, (10 - 24.8) / 42.9])


def test_realsense_deprojection_of_one_pixel_by_hand():
    """librealsense rs2_deproject_pixel_to_point, written out for one pixel."""
    k1, k2, p1, p2, k3 = D405
    x, y = (50 - 31.4) / 43.0, (10 - 24.8) / 42.9
    r2 = x * x + y * y
    f = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    expected = (
        x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * f + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
    )
    slopes = camera("inverse_brown_conrady", D405).slopes()
    assert slopes[10, 50] == pytest.approx(expected, rel=1e-12)


@given(
    model=st.sampled_from(["none", "plumb_bob", "inverse_brown_conrady"]),
    k=st.lists(st.floats(-0.06, 0.06), min_size=5, max_size=5),
    depth=st.floats(0.02, 2.0),
)
def test_projecting_a_deprojected_pixel_returns_it(model, k, depth):
    r2 = np.linspace(0, 1.5, 50)
    stretch = 1 + 3 * k[0] * r2 + 5 * k[1] * r2**2 + 7 * k[4] * r2**3
    assume(stretch.min() > 0.4)  # a lens that folds the image over has no inverse
    lens = camera(model, (k[0], k[1], k[2] / 10, k[3] / 10, k[4]))
    rays = lens.rays()
    assert np.linalg.norm(rays, axis=-1) == pytest.approx(1.0)
    back = lens.project(rays * depth)
    v, u = np.mgrid[0 : lens.height, 0 : lens.width]
    assert back[..., 0] == pytest.approx(u, abs=1e-4)
    assert back[..., 1] == pytest.approx(v, abs=1e-4)


@pytest.mark.parametrize("model", ["plumb_bob", "inverse_brown_conrady"])
def test_strong_distortion_is_inverted_to_rounding(model):
    """By Newton's method rather than a slow fixed-point iteration."""
    lens = camera(model, (-0.12, 0.05, 0.02, -0.025, 0.01))
    back = lens.project(lens.rays())
    v, u = np.mgrid[0 : lens.height, 0 : lens.width]
    np.testing.assert_allclose(back[..., 0], u, atol=1e-9)
    np.testing.assert_allclose(back[..., 1], v, atol=1e-9)


@pytest.mark.parametrize("model", ["none", "plumb_bob", "inverse_brown_conrady"])
def test_the_derivative_of_the_projection_is_its_slope(model):
    lens, step = camera(model, D405), 1e-7
    points = np.random.default_rng(0).uniform([-0.05, -0.04, 0.06], [0.05, 0.04, 0.1], (40, 3))
    pixels, slopes = lens.projection(points)
    np.testing.assert_array_equal(pixels, lens.project(points))
    for k, way in enumerate(step * np.eye(3)):
        change = lens.project(points + way) - lens.project(points - way)
        np.testing.assert_allclose(slopes[..., k], change / (2.0 * step), rtol=1e-4, atol=1e-2)


def test_points_lie_at_their_depth_along_the_optical_axis():
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # optical axis along +x of B
    T[:3, 3] = [0.1, 0.2, 0.3]
    depth_camera = DepthCamera(camera("plumb_bob", D405), T)
    depth = np.full((48, 64), 0.15, np.float32)
    points = depth_camera.points(depth, np.arange(48 * 64))
    assert points[:, 0] == pytest.approx(0.1 + 0.15, abs=1e-6)
    ranges = depth_camera.range_image(depth)
    assert np.linalg.norm(points - T[:3, 3], axis=1) == pytest.approx(ranges.ravel(), abs=1e-6)
    assert depth_camera.depth_image(ranges) == pytest.approx(depth, abs=1e-7)


def test_cameras_of_the_same_rays_share_them():
    """Every model of a sensor has a camera, and these rays are its largest array."""
    T = np.eye(4)
    first, second = (DepthCamera(camera("plumb_bob", D405), T) for _ in range(2))
    turned = DepthCamera(camera("plumb_bob", D405), np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert np.shares_memory(first.directions, second.directions)
    assert not np.shares_memory(first.directions, turned.directions)
    np.testing.assert_allclose(turned.directions, first.directions * [-1.0, -1.0, 1.0])
