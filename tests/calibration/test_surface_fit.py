"""Robust fits of exactly known surfaces."""

import numpy as np
import pytest

from bubbleviz.calibration import Ellipsoid, fit_ellipsoid, fit_sphere
from bubbleviz.errors import InputError

AXES = np.array([0.0585, 0.0416, 0.0437])


def cap(axes, outliers=0.0, noise=1e-4, count=6000):
    rng = np.random.default_rng(1)
    unit = rng.standard_normal((3 * count, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[unit[:, 2] > 0.3][:count]
    points = unit * axes + noise * rng.standard_normal(unit.shape)
    wild = rng.random(len(points)) < outliers
    points[wild] += rng.uniform(-0.02, 0.02, (int(wild.sum()), 3))
    return points + np.array([0.01, -0.02, 0.03])


@pytest.mark.parametrize(
    ("fit", "axes", "within"), [(fit_sphere, np.full(3, 0.08), 1e-4), (fit_ellipsoid, AXES, 3e-4)]
)
def test_fits_survive_outliers(fit, axes, within):
    found = fit(cap(axes, outliers=0.1))
    np.testing.assert_allclose(found.semi_axes_m, axes, atol=within)
    np.testing.assert_allclose(found.centre_m, (0.01, -0.02, 0.03), atol=within)


def test_distance_is_orthogonal_to_first_order():
    surface = Ellipsoid(np.zeros(3), AXES)
    unit = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [0.48, 0.36, 0.8]])
    on = unit * AXES
    normal = unit / AXES
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(surface.distance(on + 5e-4 * normal), 5e-4, rtol=0.02)


def test_flat_and_empty_clouds_are_refused():
    rng = np.random.default_rng(0)
    flat = rng.uniform(-0.05, 0.05, (2000, 3)) * (1.0, 1.0, 1e-4)
    with pytest.raises(InputError, match="no dome fits"):
        fit_ellipsoid(flat)
    with pytest.raises(InputError, match="only 3 usable points"):
        fit_sphere(np.zeros((3, 3)))
