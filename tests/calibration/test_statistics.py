"""Depth statistics, correlation, rim height and pixel files on synthetic data."""

import tracemalloc

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from bubbleviz.calibration import rim_height, select_pixels
from bubbleviz.camera import PixelModel, RangeLine
from bubbleviz.errors import InputError
from bubbleviz.recordings import (
    DepthStatistics,
    correlated_samples,
    error_of_mean,
    mean_inflation,
    measure_depth,
    robust_sigma,
    spatial_correlation,
    tukey_slopes,
    tukey_weights,
    upper_fence,
)


def noisy(frames=60, shape=(40, 50), rho=0.6, sigma=5e-5, seed=0):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(shape)
    out = []
    for _ in range(frames):
        noise = rho * noise + np.sqrt(1.0 - rho**2) * rng.standard_normal(shape)
        out.append(0.08 + sigma * noise)
    return np.array(out, np.float32)


def test_sigma_is_corrected_for_temporal_correlation():
    depth = noisy(frames=40, rho=0.8)
    found = measure_depth(depth, np.ones((40, 50), np.float32))
    naive = depth.std(axis=0, dtype=np.float64)
    rms = float(np.sqrt(np.mean(found.noise_m.astype(float) ** 2)))
    assert rms == pytest.approx(5e-5, rel=0.06)
    assert np.sqrt(np.mean(naive**2)) < 0.93 * 5e-5
    assert found.temporal_correlation[1] == pytest.approx(0.8, abs=0.06)


def test_the_error_of_the_mean_of_a_correlated_series():
    """Of the first order: σ √((1 + ρ) / (1 − ρ) / F)."""
    series = noisy(frames=20_000, shape=(1, 1), rho=0.6).ravel().astype(float)
    assert error_of_mean(series) == pytest.approx(5e-5 * np.sqrt(4.0 / 20_000), rel=0.2)


def test_correlated_frames_reduce_the_effective_number():
    found = measure_depth(noisy(frames=60, rho=0.6), np.ones((40, 50), np.float32))
    assert found.effective_frames == pytest.approx(60 / 4.0, rel=0.25)


def test_statistics_take_less_memory_than_the_images():
    depth = noisy(shape=(300, 400), sigma=5e-3)
    tracemalloc.start()
    try:
        measure_depth(depth, np.ones((300, 400), np.float32))
        assert tracemalloc.get_traced_memory()[1] < depth.nbytes
    finally:
        tracemalloc.stop()


def test_white_noise_has_no_spatial_correlation():
    found = measure_depth(noisy(rho=0.0), np.ones((40, 50), np.float32))
    assert np.abs(found.spatial_correlation[1:8]).max() < 0.05
    assert found.correlation_length_px < 1.0
    assert mean_inflation(found.temporal_correlation) < 1.2


@pytest.mark.parametrize("drift_m", [0.0, 2e-4])
def test_spatial_correlation_and_length_of_a_camera_filter(drift_m):
    """White noise blurred with σ = 2 px: exp(−d²/4σ²), which is 1/e at 4 px.

    A drift of the whole image is no correlation of its pixels.
    """
    rng = np.random.default_rng(0)
    blurred = gaussian_filter(rng.standard_normal((40, 80, 100)), (0.0, 2.0, 2.0), mode="wrap")
    whole = np.linspace(-drift_m, drift_m, 40)[:, None, None]
    depth = (0.08 + whole + 5e-5 * blurred / blurred.std()).astype(np.float32)
    found = measure_depth(depth, np.ones((80, 100), np.float32))
    distance = np.arange(len(found.spatial_correlation))
    expected = np.exp(-(distance**2) / 16.0)
    np.testing.assert_allclose(found.spatial_correlation[:12], expected[:12], atol=0.05)
    assert np.abs(found.spatial_correlation[20:]).max() < 0.1  # known to its end
    assert found.correlation_length_px == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("sigma", [1.5, 2.0, 4.0])
def test_correlated_pixels_per_sample_is_the_volume_under_the_correlation(sigma):
    """Of exp(−d²/4σ²) over the plane: 4 π σ²."""
    rho = np.exp(-(np.arange(33.0) ** 2) / (4.0 * sigma**2))
    assert correlated_samples(rho) == pytest.approx(4.0 * np.pi * sigma**2, rel=0.03)
    assert correlated_samples(np.array([1.0, 0.0, 0.5])) == 1.0


def test_correlation_does_not_depend_on_the_unit_of_the_spread():
    noise = gaussian_filter(np.random.default_rng(0).standard_normal((8, 40, 50)), (0.0, 1.0, 1.0))
    sigma = np.full((40, 50), noise.std())
    one, other = (spatial_correlation(noise, scale * sigma) for scale in (1.0, 3.0))
    np.testing.assert_allclose(other, one, rtol=1e-4, atol=1e-5)
    assert one[0] == 1.0 and 0.5 < one[1] < 0.95
    assert not spatial_correlation(0.0 * noise, sigma)[1:].any()


@pytest.mark.parametrize(
    ("frames", "usual", "limit"),
    [(100, 0.9, 0.72), (4, 0.9, 0.45), (100, 1.0, 0.9), (100, 0.2, 0.9)],
)
def test_regular_pixels_by_robust_spread_and_chance(frames, usual, limit):
    """Nine tenths of the usual share less 3 √(p (1 − p) / F), at least half of it."""
    validity = np.where(np.arange(100) < 45, 0.1, usual).reshape(10, 10)
    flat, rho = np.zeros((10, 10)), np.ones(1)
    found = DepthStatistics(frames, validity, flat, flat, flat, 0.0, rho, rho)
    assert found.regular_validity == pytest.approx(limit)


def test_pixel_with_one_return_has_that_value():
    depth = noisy(rho=0.0)
    depth[1:, 7, 7] = np.nan
    depth[2:, 8, 8] = np.nan
    found = measure_depth(depth, np.ones((40, 50), np.float32))
    assert found.range_m[7, 7] == pytest.approx(depth[0, 7, 7], abs=1e-9)
    assert found.range_m[8, 8] == pytest.approx(depth[:2, 8, 8].mean(), abs=1e-8)


def test_quantised_depth_keeps_its_mean():
    found, truth = quantised(5e-5)
    assert found.quantum_m == pytest.approx(1e-4, rel=1e-3)
    assert np.sqrt(np.mean((found.range_m - truth) ** 2)) < 1.2e-5  # the median: 3e-5


@pytest.mark.parametrize("sigma_m", [0.0, 2e-5, 5e-5])
def test_noise_of_quantised_depth_does_not_depend_on_the_depth(sigma_m):
    """That of the camera and of rounding together; a pixel with much more noise keeps it."""
    found, _ = quantised(sigma_m)
    noise = found.noise_m.ravel()
    expected = np.hypot(sigma_m, 1e-4 / np.sqrt(12.0))
    np.testing.assert_allclose(np.quantile(noise[1:], [0.01, 0.99]), expected, rtol=0.1)
    assert noise[0] == pytest.approx(4e-4, rel=0.3)


def test_pixels_between_two_steps_of_the_depth_are_not_unstable():
    """Without them, only pixels whose rounded depth does not follow small motions would be left."""
    found, truth = quantised(1e-5)
    chosen = select_pixels(found, np.ones(truth.shape, bool), found.range_m - truth)
    assert chosen.removed["unstable"] == 1  # the first


def quantised(sigma_m):
    """Statistics of depths in steps of 0.1 mm, of which the first is noisier, and the true ones."""
    rng = np.random.default_rng(0)
    truth, sigma = rng.uniform(0.08, 0.081, (40, 50)), np.full((40, 50), sigma_m)
    sigma[0, 0] = 4e-4
    depth = np.rint((truth + sigma * rng.standard_normal((60, 40, 50))) / 1e-4) * 1e-4
    found = measure_depth(depth.astype(np.float32), np.ones((40, 50), np.float32))
    return found, truth


def test_outliers_and_missing_returns():
    depth = noisy(rho=0.0)
    depth[::10, 3, 3] = 0.12
    depth[:, 5, 5] = np.nan
    depth[::2, 6, 6] = np.nan
    found = measure_depth(depth, np.ones((40, 50), np.float32))
    assert found.range_m[3, 3] == pytest.approx(0.08, abs=3e-5)
    assert np.isnan(found.range_m[5, 5]) and found.validity[5, 5] == 0.0
    assert found.validity[6, 6] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (noisy(frames=4), "at least 5"),
        (np.full((6, 40, 50), np.nan, np.float32), "no pixel has a valid depth"),
        (noisy(shape=(4, 4)), "sensor file"),
    ],
)
def test_unusable_frames_are_refused_in_one_line(depth, message):
    with pytest.raises(InputError, match=message) as error:
        measure_depth(depth, np.ones((40, 50), np.float32))
    assert "\n" not in str(error.value)


def test_robust_statistics():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(10_000)
    values[:1000] = 100.0
    assert robust_sigma(values) == pytest.approx(1.0, rel=0.2)
    weights = tukey_weights(np.array([0.0, 100.0, np.nan]), 1.0)
    np.testing.assert_array_equal(weights, [1.0, 0.0, 0.0])


def test_slopes_are_the_derivative_of_weighted_residuals():
    residuals, step = np.linspace(-6.0, 6.0, 25), 1e-6
    ends = [(r := residuals + side) * tukey_weights(r, 1.2) for side in (step, -step)]
    numeric = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(tukey_slopes(residuals, 1.2), numeric, atol=1e-8)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e3])
def test_the_fence_of_skewed_values_is_their_quantile_in_any_unit(unit):
    rng = np.random.default_rng(0)
    values = unit * np.exp(0.5 * rng.standard_normal(10_000))
    values[:200], values[200:300] = 0.0, np.nan
    fence = upper_fence(values, 2.0)
    assert np.mean(values[300:] < fence) == pytest.approx(0.977, abs=0.005)
    assert upper_fence(np.zeros(5), 2.0) == np.inf


def test_rim_height_from_common_edge_heights():
    rng = np.random.default_rng(0)
    edge = np.concatenate([rng.uniform(0.0, 0.02, 300), rng.normal(0.001, 3e-4, 300)])
    height, sigma = rim_height(edge)
    assert height == pytest.approx(0.001, abs=5e-4)
    assert 0.0 < sigma < 1e-3
    assert np.isnan(rim_height(np.empty(0))[0])


def test_pixels_file_round_trip_and_refusal(tmp_path):
    mask = np.zeros((4, 6), bool)
    mask[1:3, 2:5] = True
    bias = np.where(mask, 1.23e-4, 0.0).astype(np.float32)
    noise = np.where(mask, 4.5e-5, np.inf).astype(np.float32)
    PixelModel(mask, bias, noise, 7.5, removed={"never_valid": 18}).save(tmp_path / "p.npz")
    back = PixelModel.load(tmp_path / "p.npz")
    np.testing.assert_array_equal(back.mask, mask)
    np.testing.assert_allclose(back.bias_m, bias, atol=1e-6)
    np.testing.assert_allclose(back.noise_m, noise, atol=1e-6)
    assert back.correlated_pixels == pytest.approx(7.5)
    (tmp_path / "bad.npz").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"bad\.npz: the pixels file cannot be read"):
        PixelModel.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("levels", [0, 3])
def test_correction_of_some_pixels_equals_that_of_the_image(levels):
    rng = np.random.default_rng(0)
    mask, rest = rng.random((12, 16)) > 0.3, rng.uniform(0.08, 0.1, (12, 16))
    line = RangeLine(rng.uniform(0.9, 1.1, (12, 16)), rest, rest - 4e-3, rest + 6e-3, levels)
    model = PixelModel(
        mask, 1e-3 * rng.standard_normal((12, 16)), np.ones((12, 16)), 4.0, line if levels else None
    )
    image = rest + rng.uniform(-8e-3, 8e-3, (12, 16))
    pixels = rng.permutation(192)[:50]
    some, whole = model.at(pixels).corrected(image.ravel()[pixels]), model.corrected(image)
    np.testing.assert_allclose(some, whole.ravel()[pixels], atol=1e-7)
    np.testing.assert_array_equal(np.isnan(whole), ~mask)
    error = whole + model.bias_m - image  # at rest none but the bias, beyond the levels a constant
    expected = (line.slope - 1.0) * np.clip(image - rest, -4e-3, 6e-3) if levels else 0.0 * image
    np.testing.assert_allclose(error[mask], expected[mask], atol=1e-12)
