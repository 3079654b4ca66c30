"""Correlation of depth noise in time and space: cameras filter, so their noise is not white."""

from __future__ import annotations

import numpy as np


def temporal_correlation(deviations: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Correlation of the pixels' noise at lags of 0, 1, … frames, up to where it is gone.

    Deviations from a mean over the same correlated frames are too small and too little
    correlated: the variance of that mean is missing from every covariance, and is put back.

    Parameters
    ----------
    deviations : (F, H, W) array
        Samples minus the pixel's mean, m; NaN where there is none.
    sigma : (H, W) array
        Spread of the same deviations, m; pixels with 0 or NaN are left out.
    """
    frames = len(deviations)
    noise = _standardised(deviations, sigma)[:, ~np.isnan(deviations).any(axis=0) & (sigma > 0)]
    if noise.shape[1] == 0:
        return np.ones(1)
    lags = range(max(1, frames // 2))
    measured = np.array([np.mean(noise[: frames - k] * noise[k:]) for k in lags])
    measured /= measured[0]
    # Cut before correcting: the corrected tail hovers about zero and would sum to anything.
    measured = measured[: _first_not_positive(measured)]
    missing = mean_inflation(measured) / frames
    return (measured + missing) / (1.0 + missing)


def mean_inflation(rho: np.ndarray) -> float:
    """Variance of a mean over that of the same mean of white noise: 1 + 2 Σ ρ ≥ 1.

    Summed up to the first lag that is not positive, beyond which an estimate is only noise.
    """
    return 1.0 + 2.0 * float(np.sum(rho[1 : _first_not_positive(rho)]))


def error_of_mean(series: np.ndarray) -> float:
    """Standard error of the mean of a series (F,) whose values are correlated."""
    centred = series - series.mean()
    power = float(np.mean(centred**2))
    if power == 0.0:
        return 0.0
    lags = range(max(1, len(series) // 2))
    rho = np.array([np.mean(centred[lag:] * centred[: len(series) - lag]) / power for lag in lags])
    return float(np.sqrt(power * mean_inflation(rho) / len(series)))


def spatial_correlation(
    deviations: np.ndarray, sigma: np.ndarray, stride: int = 1, reach: int = 32
) -> np.ndarray:
    """Correlation of one frame's noise at 0, 1, … `reach` pixels along rows and columns.

    Parameters
    ----------
    deviations : (F, H, W) array
        Samples minus the pixel's mean, m; NaN where there is none.
    sigma : (H, W) array
        Spread of the same deviations, m.
    stride : int
        Every how many-th frame to use (neighbours in time say the same).
    reach : int
        Largest distance, pixels; less where the image is small.
    """
    noise = _standardised(deviations[::stride], sigma)
    used = np.isfinite(noise)
    noise = np.where(used, noise, np.float32(0.0))
    weight = used.astype(np.float32)
    reach = min(reach, min(noise.shape[1:]) // 2)
    rho = np.ones(reach + 1)
    power = float(np.sum(noise**2, dtype=np.float64) / max(1.0, np.sum(weight, dtype=np.float64)))
    for k in range(1, reach + 1):
        product = pairs = 0.0
        for a, b in (
            (np.s_[:, :, k:], np.s_[:, :, :-k]),
            (np.s_[:, k:, :], np.s_[:, :-k, :]),
        ):
            product += float(np.vdot(noise[a], noise[b]))
            pairs += float(np.vdot(weight[a], weight[b]))
        rho[k] = product / max(pairs, 1.0) / power if power > 0.0 else 0.0
    return rho


def correlated_samples(rho: np.ndarray) -> float:
    """Samples of a plane worth one independent: the spatial correlation (M,) summed over it."""
    distance = np.arange(1, _first_not_positive(rho))
    return 1.0 + float(np.sum(2.0 * np.pi * distance * rho[distance]))


def _standardised(deviations: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Deviations in units of each pixel's own spread, so that unstable pixels do not dominate."""
    scale = np.where(sigma > 0.0, sigma, np.nan).astype(np.float32)
    return deviations / scale


def _first_not_positive(rho: np.ndarray) -> int:
    stop = np.flatnonzero(rho <= 0.0)
    return int(stop[0]) if len(stop) else len(rho)
