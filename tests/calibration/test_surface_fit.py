"""Robust fits against surfaces known exactly."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.calibration import Ellipsoid, fit_ellipsoid, fit_sphere
from bubbleviz.errors import InputError

AXES = np.array([0.0585, 0.0416, 0.0437])


def cap(axes, rotation=None, outliers=0.0, noise=1e-4, count=6000, seed=1):
    rng = np.random.default_rng(seed)
    unit = rng.standard_normal((3 * count, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[unit[:, 2] > 0.3][:count]
    points = unit * axes + noise * rng.standard_normal(unit.shape)
    wild = rng.random(len(points)) < outliers
    points[wild] += rng.uniform(-0.02, 0.02, (int(wild.sum()), 3))
    if rotation is not None:
        points = points @ rotation.T
    return points + np.array([0.01, -0.02, 0.03])


@pytest.mark.parametrize(
    ("fit", "axes", "within"),
    [
        (fit_sphere, np.full(3, 0.08), 1e-4),
        (lambda points: fit_ellipsoid(points, np.eye(3)), AXES, 3e-4),
    ],
)
def test_fits_survive_outliers(fit, axes, within):
    found = fit(cap(axes, outliers=0.1))
    np.testing.assert_allclose(found.semi_axes_m, axes, atol=within)
    np.testing.assert_allclose(found.centre_m, (0.01, -0.02, 0.03), atol=within)
    assert found.rms_m == pytest.approx(1e-4, rel=0.2)


def test_tilted_ellipsoid_finds_its_tilt():
    rotation = Rotation.from_euler("y", 6.0, degrees=True).as_matrix()
    fit = fit_ellipsoid(cap(AXES, rotation, outliers=0.05))
    assert np.degrees(fit.tilt_rad) == pytest.approx(6.0, abs=0.5)
    np.testing.assert_allclose(np.sort(fit.semi_axes_m), np.sort(AXES), atol=5e-4)


def test_distance_is_orthogonal_to_first_order():
    surface = Ellipsoid(np.zeros(3), AXES, np.eye(3))
    unit = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [0.48, 0.36, 0.8]])
    on = unit * AXES
    normal = unit / AXES
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.distance(on + 5e-4 * normal), 5e-4, rtol=0.02)


def test_flat_and_empty_clouds_are_refused():
    rng = np.random.default_rng(0)
    flat = rng.uniform(-0.05, 0.05, (2000, 3)) * (1.0, 1.0, 1e-4)
    with pytest.raises(InputError, match="no dome fits"):
        fit_ellipsoid(flat, np.eye(3))
    with pytest.raises(InputError, match="only 3 points"):
        fit_sphere(np.zeros((3, 3)))
