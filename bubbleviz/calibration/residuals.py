"""How well an identified sensor explains contact-free frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.rest.pixel_selection import PixelStatistics
from bubbleviz.calibration.robust_statistics import robust_sigma, tukey_weights
from bubbleviz.frames.frame import Frame


@dataclass(frozen=True)
class Residuals:
    """Measured minus modelled range over the used pixels of some frames.

    Attributes
    ----------
    rms_m : float
        Of the surface alone, no bias subtracted, m.
    sigma_m : float
        The same from the median absolute deviation, m.
    percentiles_m : tuple of float
        50th, 95th and 99th percentile of the absolute residual, m.
    rectified_rms_m : float
        After the bias image is subtracted, m.
    drift_m : (F,) array
        Mean rectified residual of each frame without its outliers (Tukey), m: what a slow
        drift would show in.
    """

    rms_m: float
    sigma_m: float
    percentiles_m: tuple[float, float, float]
    rectified_rms_m: float
    drift_m: np.ndarray


def measure_residuals(
    frames: Iterable[Frame],
    modelled_range_m: np.ndarray,
    range_per_depth: np.ndarray,
    pixels: PixelStatistics,
) -> Residuals:
    """Residuals of frames against the surface, with and without the bias image.

    Parameters
    ----------
    frames : iterable of Frame
        Best ones that took no part in the fit.
    modelled_range_m : (H, W) array
        Range of the rays cast on the reference surface, m.
    range_per_depth : (H, W) array
        `DepthCamera.range_per_depth`.
    pixels : PixelStatistics
    """
    used, bias = pixels.mask, pixels.bias_m[pixels.mask]
    model, scale = modelled_range_m[used], range_per_depth[used]
    raw = np.stack([frame.depth_m[used] * scale - model for frame in frames])
    rectified = raw - bias
    absolute = np.abs(raw[np.isfinite(raw)])
    p50, p95, p99 = np.percentile(absolute, [50.0, 95.0, 99.0])
    return Residuals(
        rms_m=float(np.sqrt(np.nanmean(raw**2))),
        sigma_m=robust_sigma(raw),
        percentiles_m=(float(p50), float(p95), float(p99)),
        rectified_rms_m=float(np.sqrt(np.nanmean(rectified**2))),
        drift_m=np.array([_location(frame[np.isfinite(frame)]) for frame in rectified]),
    )


def _location(values: np.ndarray) -> float:
    weights = tukey_weights(values - np.median(values), robust_sigma(values))
    return float(np.average(values, weights=weights))
