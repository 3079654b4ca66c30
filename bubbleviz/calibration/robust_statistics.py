"""Robust statistics: location, scale and weights."""

from __future__ import annotations

import numpy as np

MAD_TO_SIGMA = 1.482602218505602
"""1/Φ⁻¹(3/4): standard deviation per median absolute deviation of a normal distribution."""

TUKEY_TUNING = 4.685
"""Tuning of Tukey's biweight at which it is 95 % efficient on normal residuals."""


def robust_sigma(residuals: np.ndarray, center: float | None = None) -> float:
    """Standard deviation estimated from the median absolute deviation, in the input's unit.

    Parameters
    ----------
    residuals : array
        Any shape; NaN is left out.
    center : float, optional
        What deviations are taken from; the median where it is not given.
    """
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
    """Derivative of residual × weight of Tukey's biweight: what a sample's shift moves it by."""
    square = (residuals / max(TUKEY_TUNING * sigma, np.finfo(float).tiny)) ** 2
    return np.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0)


def cauchy_weights(residuals: np.ndarray, sigma: float) -> np.ndarray:
    """Weights in 0 … 1 of Cauchy's loss, which leads from far away: none are 0."""
    return 1.0 / (1.0 + (residuals / max(sigma, np.finfo(float).tiny)) ** 2)


def upper_fence(values: np.ndarray, deviations: float) -> float:
    """Value that so many robust standard deviations above the median of log(values) give.

    For positive, skewed quantities such as a standard deviation over the pixels of an image.
    """
    logs = np.log(values[np.isfinite(values) & (values > 0.0)])
    if logs.size == 0:
        return float("inf")
    return float(np.exp(np.median(logs) + deviations * robust_sigma(logs)))
