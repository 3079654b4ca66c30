"""Rectification of a camera whose every pixel has its own scale and offset."""

import numpy as np
import pytest

from bubbleviz.calibration import Level, fit_lines, identify
from bubbleviz.errors import InputError

from .domes import sphere

SHAPE = (20, 30)


def wrong_camera(seed=0):
    rng = np.random.default_rng(seed)
    return 1.0 + 0.02 * rng.standard_normal(SHAPE), 1e-3 * rng.standard_normal(SHAPE)


def level(true_m, scale, offset, noise=1e-5):
    measured = scale * true_m + offset
    return Level(measured, np.full(SHAPE, true_m), np.full(SHAPE, noise))


def test_two_levels_give_each_pixel_its_line():
    scale, offset = wrong_camera()
    fitted = fit_lines([level(0.12, scale, offset), level(0.14, scale, offset)])
    np.testing.assert_allclose(fitted.slope, 1.0 / scale, rtol=1e-9)


def test_a_third_level_is_averaged_not_followed():
    """Least squares through three points of which the last is 0.3 mm off over 20 mm."""
    scale, offset = wrong_camera()
    levels = [level(r, scale, offset) for r in (0.12, 0.13, 0.14)]
    off = Level(levels[2].measured_m + 3e-4, levels[2].modelled_m, levels[2].noise_m)
    fitted = fit_lines([levels[0], levels[1], off])
    np.testing.assert_allclose(fitted.slope, 1.0 / (scale + 3e-4 / 0.02), rtol=1e-3)


def test_the_line_ends_where_the_levels_do():
    scale, offset = wrong_camera()
    fitted = fit_lines([level(0.12, scale, offset), level(0.14, scale, offset)])
    measured = scale * 0.12 + offset, scale * 0.14 + offset
    for limit, end in zip((fitted.nearest_m, fitted.farthest_m), measured, strict=True):
        assert np.all(np.abs(limit - end) > 2e-5)  # noise of the level is not beyond it
        assert np.all(np.abs(limit - end) < 1e-4)


def test_useless_levels_are_refused():
    scale, offset = wrong_camera()
    one = level(0.12, scale, offset, noise=1e-3)
    with pytest.raises(InputError, match="within the noise"):
        fit_lines([one, level(0.121, scale, offset, noise=1e-3)])
    small = Level(one.measured_m[:5], one.modelled_m[:5], one.noise_m[:5])
    with pytest.raises(InputError, match="one camera"):
        fit_lines([one, small])


def test_level_of_an_identification_keeps_to_the_pixels_in_use():
    dome = sphere(0, frames=12)
    found = identify(dome, dome.sensor, nodes=200)
    own, mask = Level.of(found), found.pixels.mask
    for image in (own.measured_m, own.modelled_m):
        np.testing.assert_array_equal(np.isfinite(image), mask)
    off = (own.measured_m - own.modelled_m)[mask]
    np.testing.assert_allclose(off, found.pixels.bias_m[mask], atol=1e-8)
