"""Statistics of each pixel over contact-free depth frames: validity, mean, noise."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from bubbleviz.camera import row_median
from bubbleviz.errors import InputError
from bubbleviz.wording import width_by_height

_REACH_PX = 32  # largest distance of correlations, if the image is large enough
_THREADS = 2  # numpy sorts, sums and transforms without the interpreter's lock

# Correlation of depth noise in time and space: cameras filter, so their noise is not white.


def temporal_correlation(
    deviations: np.ndarray,  # (F, H, W), samples minus the pixel's mean, m; NaN for no return
    # (H, W), spread of the same deviations, m; pixels with 0 or NaN are left out
    sigma: np.ndarray,
) -> np.ndarray:
    """Correlation of the pixels' noise at lags of 0, 1, … frames, up to its first zero.

    Corrected for bias: deviations from the mean of the same frames lack the variance of that mean
    in every covariance.
    """
    flat, spread = deviations.reshape(len(deviations), -1), sigma.ravel()
    parts = _parts(spread.size)
    return _correlation(_products(flat[:, part], spread[part]) for part in parts)


def _products(deviations: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Sums (F, F) over some pixels of the products of their noise in two frames."""
    noise = _standardised(deviations, sigma)
    noise = noise[:, np.isfinite(noise).all(axis=0)]
    return (noise @ noise.T).astype(float)


def _correlation(products: Iterable[np.ndarray]) -> np.ndarray:
    """Correlation at lags 0, 1, … from `_products` (F, F) of all parts of an image."""
    total = np.sum(list(products), axis=0)
    if not total.any():
        return np.ones(1)
    lags = range(max(1, len(total) // 2))
    return _unbiased(np.array([np.mean(np.diagonal(total, k)) for k in lags]), len(total))


def _unbiased(covariance: np.ndarray, frames: int) -> np.ndarray:
    """Correlation at lags 0, 1, … up to its first zero, from covariances about the frames' mean."""
    measured = covariance / covariance[0]
    # Cut before correcting: the corrected tail fluctuates about zero and has an arbitrary sum.
    measured = measured[: _first_not_positive(measured)]
    missing = mean_inflation(measured) / frames
    return (measured + missing) / (1.0 + missing)


def mean_inflation(rho: np.ndarray) -> float:
    """Variance of a mean relative to that for white noise: 1 + 2 Σ ρ ≥ 1.

    Summed up to the first lag that is not positive, beyond which estimates are only noise.
    """
    return 1.0 + 2.0 * float(np.sum(rho[1 : _first_not_positive(rho)]))


def error_of_mean(series: np.ndarray, fitted: int = 1) -> float:
    """Standard error of the mean of a series (F,) whose values are correlated.

    Widened by Student's quantile over the normal one for the effective number of values, so that
    ±1.96 times it is a 95 % interval. `fitted`: number of parameters fitted to the series; 1: only
    the mean.
    """
    centred, frames = series - series.mean(), len(series)
    if not centred.any():
        return 0.0
    lags = range(max(1, frames // 2))
    covariance = np.array([np.mean(centred[k:] * centred[: frames - k]) for k in lags])
    effective = max(1.0 + fitted, frames / mean_inflation(_unbiased(covariance, frames)))
    freedom = effective - fitted
    return float(np.sqrt(covariance[0] / freedom)) * student_factor(freedom)


def student_factor(freedom: float) -> float:
    """Ratio of Student's 95 % interval to the normal one."""
    return float(stdtrit(freedom, 0.975) / ndtri(0.975))


def spatial_correlation(
    deviations: np.ndarray,  # (F, H, W), samples minus the pixel's mean, m; NaN for no return
    sigma: np.ndarray,  # (H, W), spread of the same deviations, m
) -> np.ndarray:
    """Correlation of one frame's noise at 0, 1, … 32 pixels along rows and columns.

    About the mean of each frame: drift of the whole image does not count as correlation of pixels.
    """
    reach = min(_REACH_PX, min(sigma.shape) // 2)
    rows, columns = (slice(None, None, max(1, size // _LINES)) for size in sigma.shape)

    def products(image: np.ndarray) -> np.ndarray:
        total = np.zeros((2, reach + 1))
        for axis, lines in enumerate(((slice(None), columns), (rows, slice(None)))):
            noise = _standardised(image[lines], sigma[lines])
            used = np.isfinite(noise)
            noise -= np.mean(noise, where=used) if used.any() else 0.0
            both = np.where(used, noise, np.float32(0.0)), used.astype(np.float32)
            total += [_lagged_products(each, axis, reach) for each in both]
        return total

    with ThreadPoolExecutor(_THREADS) as threads:
        product, pairs = np.sum(list(threads.map(products, deviations)), axis=0)
    mean = product / np.maximum(pairs, 1.0)
    return mean / mean[0] if mean[0] > 0.0 else np.eye(1, reach + 1)[0]


def _lagged_products(image: np.ndarray, axis: int, reach: int) -> np.ndarray:
    """Sums of the products of pixels 0, 1, … `reach` apart along an axis, (reach + 1,)."""
    size = image.shape[axis] + reach
    spectrum = np.fft.rfft(image, size, axis=axis)
    power = np.sum(spectrum.real**2 + spectrum.imag**2, axis=1 - axis, dtype=np.float64)
    return np.fft.irfft(power, size)[: reach + 1]


def correlated_samples(rho: np.ndarray) -> float:
    """Correlated samples per independent one: spatial correlation (M,) summed over the plane."""
    distance = np.arange(1, _first_not_positive(rho))
    return 1.0 + float(np.sum(2.0 * np.pi * distance * rho[distance]))


def _standardised(deviations: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Deviations in units of each pixel's own spread, so that unstable pixels do not dominate."""
    scale = np.where(sigma > 0.0, sigma, np.nan).astype(np.float32)
    return deviations / scale


def _first_not_positive(rho: np.ndarray) -> int:
    stop = np.flatnonzero(rho <= 0.0)
    return int(stop[0]) if len(stop) else len(rho)


# Robust statistics: location, scale and weights.


MAD_TO_SIGMA = 1.482602218505602
"""1/Φ⁻¹(3/4): standard deviation per median absolute deviation of a normal distribution."""

TUKEY_TUNING = 4.685  # tuning of Tukey's biweight at which it is 95 % efficient on normal residuals


def robust_sigma(
    residuals: np.ndarray,  # any shape; NaN is left out
    center: float | None = None,  # reference of the deviations; default: the median
) -> float:
    """Standard deviation estimated from the median absolute deviation, in the input's unit."""
    values = residuals[np.isfinite(residuals)]
    if values.size == 0:
        return float("nan")
    middle = float(np.median(values)) if center is None else center
    return MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))


def tukey_weights(residuals: np.ndarray, sigma: float) -> np.ndarray:
    """Weights in 0 … 1 of Tukey's biweight: 0 beyond 4.685 σ, and where NaN."""
    scaled = residuals / max(TUKEY_TUNING * sigma, np.finfo(float).tiny)
    return np.where(np.abs(scaled) < 1.0, (1.0 - scaled**2) ** 2, 0.0)


def tukey_slopes(residuals: np.ndarray, sigma: float) -> np.ndarray:
    """Derivative of residual × weight of Tukey's biweight with respect to the residual."""
    square = (residuals / max(TUKEY_TUNING * sigma, np.finfo(float).tiny)) ** 2
    return np.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0)


def tukey_loss(squares: np.ndarray) -> np.ndarray:
    """Tukey's loss of (residual/σ)² (k,) with two derivatives, (3, k), in scipy's form."""
    left = 1.0 - np.minimum(squares / TUKEY_TUNING**2, 1.0)
    return np.stack(
        [TUKEY_TUNING**2 / 3.0 * (1.0 - left**3), left**2, -2.0 / TUKEY_TUNING**2 * left]
    )


def upper_fence(values: np.ndarray, deviations: float) -> float:
    """Value a number of robust standard deviations above the median of log(values).

    For positive, skewed quantities such as a standard deviation over the pixels of an image.
    """
    logs = np.log(values[np.isfinite(values) & (values > 0.0)])
    if logs.size == 0:
        return float("inf")
    return float(np.exp(np.median(logs) + deviations * robust_sigma(logs)))


LAG = 5  # frames; longer than the memory of the camera's temporal filter
MIN_FRAMES = 5  # fewest frames for a median and a spread of each pixel

_CLIP_SIGMA = 3.0  # samples further from the median are outliers
_IMAGES, _LINES = 20, 240
"""For the spatial correlation, and rows or columns of each: neighbours are redundant."""
_PART = 2**12  # pixels treated at a time, so that their samples fit the processor's cache


def _parts(pixels: int) -> list[slice]:
    return [slice(start, start + _PART) for start in range(0, pixels, _PART)]


@dataclass(frozen=True)
class DepthStatistics:
    """Statistics over contact-free frames, per pixel of an H×W image."""

    frames: int  # frames F they come from
    # (H, W) float32, share of the frames in which the pixel has a return, 0 … 1
    validity: np.ndarray
    # (H, W) float64, mean range along the ray after clipping at 3 σ around the median, m; NaN: no
    # return
    range_m: np.ndarray
    scatter_m: np.ndarray  # (H, W), that of each pixel and of rounding; shows unstable pixels, m
    # (H, W) float32, standard deviation σ of one frame's range, clipped likewise, corrected for
    # temporal correlation, at least the quantisation's q/√12, m; NaN: no return
    noise_m: np.ndarray
    quantum_m: float  # step q of the z-depth, m; 0 where it is continuous
    temporal_correlation: np.ndarray  # (L,), correlation of a pixel's noise at lags 0, 1, … frames
    # (M,), correlation of one frame's noise at distances 0, 1, … pixels
    spatial_correlation: np.ndarray

    @property
    def effective_frames(self) -> float:
        """Number of independent frames with the same variance of the mean."""
        return self.frames / mean_inflation(self.temporal_correlation)

    @property
    def regular_validity(self) -> float:
        """Share of frames with a return below which a pixel is irregular.

        Nine tenths of the usual share, minus the sampling error for this number of frames.
        """
        returning = self.validity[self.validity > 0.5]
        usual = float(np.median(returning)) if returning.size else 1.0
        chance = np.sqrt(usual * (1.0 - usual) / self.frames)
        return max(0.9 * usual - 3.0 * chance, 0.5 * usual)

    @property
    def correlation_length_px(self) -> float:
        """Distance at which the spatial correlation has fallen to 1/e, in pixels.

        The range of the camera's matching window and filters: pixels closer to an edge than this
        mix both sides of it.
        """
        rho = self.spatial_correlation
        below = np.flatnonzero(rho < np.exp(-1.0))
        if not len(below):
            return float(len(rho) - 1)
        k = int(below[0])
        return k - 1 + float((rho[k - 1] - np.exp(-1.0)) / (rho[k - 1] - rho[k]))

    @property
    def correlated_pixels(self) -> float:
        """Pixels per independent sample: the correlation summed over the plane."""
        return correlated_samples(self.spatial_correlation)


def measure_depth(
    depth: np.ndarray,  # (F, H, W) float32, z-depth in m; NaN: no return
    # (H, W), range along the ray per z-depth (`DepthCamera.range_per_depth`)
    range_per_depth: np.ndarray,
) -> DepthStatistics:
    """Measure every pixel over contact-free frames.

    Raises InputError: fewer than 5 frames, another size than the camera's, or no return at all.
    """
    if len(depth) < MIN_FRAMES:
        raise InputError(
            f"depth images: only {len(depth)}; give at least {MIN_FRAMES} without contact"
        )
    if depth.shape[1:] != range_per_depth.shape:
        raise InputError(
            f"depth images: {width_by_height(depth.shape[1:])} pixels but the sensor file has "
            f"{width_by_height(range_per_depth.shape)}; choose the sensor file of "
            "this camera"
        )
    if not np.isfinite(depth).any():
        raise InputError(
            "depth images: no pixel has a valid depth in any frame; uncover the camera, or keep "
            "the membrane beyond the camera's shortest range, and record again"
        )
    quantum, shape = _quantum(depth), depth.shape[1:]
    flat = depth.reshape(len(depth), -1)
    validity, mean, sigma = np.empty((3, flat.shape[1]))
    some = slice(None, None, -(-len(depth) // _IMAGES))  # neighbours in time are redundant
    deviations = np.empty_like(flat[some])

    def measure(part: slice) -> np.ndarray:
        validity[part], mean[part], sigma[part], noise = _clipped_moments(flat[:, part], quantum)
        deviations[:, part] = noise[some]
        return _products(noise, sigma[part])

    with ThreadPoolExecutor(_THREADS) as threads:
        temporal = _correlation(threads.map(measure, _parts(len(mean))))
    validity, mean, sigma = (each.reshape(shape) for each in (validity, mean, sigma))
    # of the variance, as the mean of the same samples is removed
    share = 1.0 - mean_inflation(temporal) / len(depth)
    variance = sigma**2 / max(share, 1.0 / len(depth))
    scatter = np.sqrt(variance + quantum**2 / 12.0)
    if quantum:
        # Rounding changes the variance of a pixel by up to q²/4, depending on its depth at rest.
        # Weighted by it, pixels would count most whose rounded depth does not follow small motions.
        usual = np.abs(variance - np.nanmedian(variance)) <= quantum**2 / 4.0
        variance[usual] = variance[usual].mean()
    noise = np.sqrt(np.maximum(variance, quantum**2 / 12.0))
    spatial = spatial_correlation(deviations.reshape(-1, *shape), sigma)
    return DepthStatistics(
        frames=len(depth),
        validity=validity.astype(np.float32),
        range_m=mean * range_per_depth,
        scatter_m=(scatter * range_per_depth).astype(np.float32),
        noise_m=(noise * range_per_depth).astype(np.float32),
        quantum_m=quantum,
        temporal_correlation=temporal,
        spatial_correlation=spatial,
    )


def _quantum(depth: np.ndarray) -> float:
    """Step between the distinct depths of a frame; 0 for a continuous measurement."""
    image = depth[0]
    levels = np.unique(image[np.isfinite(image)])
    if len(levels) < 2:
        return 0.0
    # As many levels as pixels: continuous. A quantised image repeats each level many times.
    if len(levels) > 0.5 * np.count_nonzero(np.isfinite(image)):
        return 0.0
    return float(np.median(np.diff(levels.astype(np.float64))))


def _clipped_moments(
    depth: np.ndarray,  # (F, P), m
    quantum: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Share of samples, mean and spread of those near each pixel's median, and deviations (F, P).

    The median alone would have a quantisation error; the mean alone would include outliers.
    """
    samples = np.ascontiguousarray(depth.T)  # numpy sorts contiguous samples five times as fast
    counts = np.isfinite(samples).sum(axis=1)
    median = row_median(samples)
    deviations = samples - median[:, None]
    size = np.abs(deviations)
    limit = _CLIP_SIGMA * np.maximum(MAD_TO_SIGMA * row_median(size), quantum)
    kept = size <= limit[:, None]
    number = np.maximum(kept.sum(axis=1), 1)
    shift = np.sum(np.where(kept, deviations, np.float32(0.0)), axis=1, dtype=np.float64) / number
    deviations -= shift.astype(np.float32)[:, None]
    squares = np.where(kept, deviations**2, np.float32(0.0))
    variance = np.sum(squares, axis=1, dtype=np.float64) / number
    deviations[~kept] = np.nan
    mean = np.where(counts > 0, median.astype(np.float64) + shift, np.nan)
    spread = np.where(counts > 0, np.sqrt(variance), np.nan)
    return counts / len(depth), mean, spread, np.ascontiguousarray(deviations.T)
