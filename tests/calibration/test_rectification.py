"""Rectification of a camera whose every pixel has its own scale and offset."""

import numpy as np
import pytest

from bubbleviz.calibration.identification import identify
from bubbleviz.calibration.rectification import Level, fit_rectification
from bubbleviz.errors import InputError

from .domes import sphere

SHAPE = (20, 30)


def wrong_camera(seed=0):
    rng = np.random.default_rng(seed)
    return 1.0 + 0.02 * rng.standard_normal(SHAPE), 1e-3 * rng.standard_normal(SHAPE)


def level(true_m, scale, offset, noise=1e-5):
    measured = scale * true_m + offset
    return Level(measured, np.full(SHAPE, true_m), np.full(SHAPE, noise))


def rectified(fitted, range_m):
    return fitted.offset_m + fitted.slope * range_m


def test_two_levels_give_each_pixel_its_line():
    scale, offset = wrong_camera()
    fitted = fit_rectification([level(0.12, scale, offset), level(0.14, scale, offset)])
    np.testing.assert_allclose(rectified(fitted, scale * 0.131 + offset), 0.131, atol=1e-12)


def test_a_third_level_is_averaged_not_followed():
    scale, offset = wrong_camera()
    levels = [level(r, scale, offset) for r in (0.12, 0.13, 0.14)]
    off = Level(levels[1].measured_m + 3e-4, levels[1].modelled_m, levels[1].noise_m)
    fitted = fit_rectification([levels[0], off, levels[2]])
    np.testing.assert_allclose(rectified(fitted, scale * 0.13 + offset), 0.13 - 1e-4, atol=2e-5)


def test_the_line_ends_where_the_levels_do():
    scale, offset = wrong_camera()
    fitted = fit_rectification([level(0.12, scale, offset), level(0.14, scale, offset)])
    measured = scale * 0.12 + offset, scale * 0.14 + offset
    for limit, end in zip((fitted.nearest_m, fitted.farthest_m), measured, strict=True):
        assert np.all(np.abs(limit - end) > 2e-5)  # noise of the level is not beyond it
        assert np.all(np.abs(limit - end) < 1e-4)


def test_one_level_is_an_offset():
    scale, offset = wrong_camera()
    fitted = fit_rectification([level(0.12, scale, offset)])
    at_level = scale * 0.12 + offset
    np.testing.assert_allclose(rectified(fitted, at_level), 0.12)
    np.testing.assert_allclose(rectified(fitted, at_level - 0.01), 0.11)


def test_useless_levels_are_refused():
    scale, offset = wrong_camera()
    one = level(0.12, scale, offset, noise=1e-3)
    with pytest.raises(InputError, match="within the noise"):
        fit_rectification([one, level(0.121, scale, offset, noise=1e-3)])
    with pytest.raises(InputError, match="at least one"):
        fit_rectification([])
    small = Level(one.measured_m[:5], one.modelled_m[:5], one.noise_m[:5])
    with pytest.raises(InputError, match="one camera"):
        fit_rectification([one, small])


def test_level_of_an_identification_keeps_to_the_pixels_in_use():
    dome = sphere(0, frames=12)
    found = identify(dome, dome.sensor, nodes=200)
    fitted = fit_rectification([Level.of(found)])
    np.testing.assert_array_equal(np.isfinite(fitted.offset_m), found.pixels.mask)
    mask = found.pixels.mask
    after = rectified(fitted, found.statistics.range_m)[mask] - found.modelled_range_m[mask]
    np.testing.assert_allclose(after, 0.0, atol=1e-12)
