"""What contact-free depth frames say about every pixel: how often, how far, how noisy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.rest.noise_correlation import (
    correlated_samples,
    mean_inflation,
    spatial_correlation,
    temporal_correlation,
)
from bubbleviz.calibration.robust_statistics import MAD_TO_SIGMA
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame

MIN_FRAMES = 5
"""Frames below which neither a median nor a spread per pixel means anything."""

_CLIP_SIGMA = 3.0  # samples further from the median than this are not noise of the same kind


@dataclass(frozen=True)
class DepthStatistics:
    """Statistics over contact-free frames, per pixel of an H×W image.

    Attributes
    ----------
    frames : int
        Frames F they come from.
    validity : (H, W) float32 array
        Share of the frames in which the pixel has a return, 0 … 1.
    range_m : (H, W) float64 array
        Mean range along the ray after clipping at 3 σ around the median, m; NaN: no return.
    noise_m : (H, W) float32 array
        Standard deviation σ of one frame's range, clipped likewise, corrected for temporal
        correlation, at least the quantisation's q/√12, m; NaN: no return.
    quantum_m : float
        Step q of the z-depth, m; 0 where it is continuous.
    temporal_correlation : (L,) array
        Correlation of a pixel's noise at lags 0, 1, … frames.
    spatial_correlation : (M,) array
        Correlation of one frame's noise at distances 0, 1, … pixels.
    """

    frames: int
    validity: np.ndarray
    range_m: np.ndarray
    noise_m: np.ndarray
    quantum_m: float
    temporal_correlation: np.ndarray
    spatial_correlation: np.ndarray

    @property
    def effective_frames(self) -> float:
        """Independent frames that would give the mean as small a variance."""
        return self.frames / mean_inflation(self.temporal_correlation)

    @property
    def regular_validity(self) -> float:
        """Share of frames with a return below which a pixel is worse than its like.

        Nine tenths of what is usual, less what chance takes from so few frames.
        """
        returning = self.validity[self.validity > 0.5]
        usual = float(np.median(returning)) if returning.size else 1.0
        chance = np.sqrt(usual * (1.0 - usual) / self.frames)
        return max(0.9 * usual - 3.0 * chance, 0.5 * usual)

    @property
    def correlation_length_px(self) -> float:
        """Distance at which the spatial correlation has fallen to 1/e, in pixels.

        The reach of the camera's matching window and filters: what is closer to an edge than
        this mixes both sides of it.
        """
        rho = self.spatial_correlation
        below = np.flatnonzero(rho < np.exp(-1.0))
        if not len(below):
            return float(len(rho) - 1)
        k = int(below[0])
        return k - 1 + float((rho[k - 1] - np.exp(-1.0)) / (rho[k - 1] - rho[k]))

    @property
    def correlated_pixels(self) -> float:
        """Pixels that share one independent sample: the correlation summed over the plane."""
        return correlated_samples(self.spatial_correlation)


def stack_depth(frames: Iterable[Frame] | np.ndarray) -> np.ndarray:
    """Depth images as one (F, H, W) float32 array in m, NaN for no return."""
    stack: np.ndarray
    if isinstance(frames, np.ndarray):
        stack = np.asarray(frames, np.float32)
    else:
        images = [frame.depth_m for frame in frames]
        if len({image.shape for image in images}) > 1:
            raise InputError("depth frames: sizes differ; give frames of one camera and mode")
        stack = np.stack(images).astype(np.float32, copy=False) if images else np.empty((0, 0, 0))
    if stack.ndim != 3 or len(stack) < MIN_FRAMES:
        raise InputError(
            f"depth frames: {len(stack)} contact-free frames; give at least {MIN_FRAMES}"
        )
    return stack


def measure_depth(
    frames: Iterable[Frame] | np.ndarray, range_per_depth: np.ndarray
) -> DepthStatistics:
    """Measure every pixel over contact-free frames.

    Parameters
    ----------
    frames : iterable of Frame, or (F, H, W) array
        z-depth in m, NaN for no return.
    range_per_depth : (H, W) array
        Range along the ray per z-depth (`DepthCamera.range_per_depth`).

    Raises
    ------
    InputError
        Fewer than 5 frames, sizes that differ, or no return at all.
    """
    depth = stack_depth(frames)
    if depth.shape[1:] != range_per_depth.shape:
        raise InputError(
            f"depth frames: {depth.shape[2]}×{depth.shape[1]} pixels but the camera has"
            f" {range_per_depth.shape[1]}×{range_per_depth.shape[0]}; use its own sensor file"
        )
    valid = np.isfinite(depth)
    if not valid.any():
        raise InputError("depth frames: no pixel has a return; check the camera")
    quantum = _quantum(depth)
    mean, sigma, deviations = _clipped_moments(depth, quantum)
    temporal = temporal_correlation(deviations, sigma)
    share = 1.0 - mean_inflation(temporal) / len(depth)  # spread lost to the mean it is taken from
    noise = np.sqrt(sigma**2 / max(share, 1.0 / len(depth)) + quantum**2 / 12.0)
    spatial = spatial_correlation(deviations, sigma, stride=max(1, len(depth) // 20))
    return DepthStatistics(
        frames=len(depth),
        validity=valid.mean(axis=0, dtype=np.float32),
        range_m=mean * range_per_depth,
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
    depth: np.ndarray, quantum: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and spread of the samples near each pixel's median, and the deviations kept.

    The median alone would keep the quantisation's error; the mean alone, the outliers.
    """
    counts = np.isfinite(depth).sum(axis=0)
    median = _median(depth, counts)
    deviations = depth - median
    spread = MAD_TO_SIGMA * _median(np.abs(deviations), counts)
    deviations[np.abs(deviations) > _CLIP_SIGMA * np.maximum(spread, quantum)] = np.nan
    kept = np.isfinite(deviations)
    number = np.maximum(kept.sum(axis=0), 1)
    shift = np.sum(deviations, axis=0, where=kept, dtype=np.float64) / number
    deviations -= shift.astype(np.float32)
    variance = np.sum(deviations**2, axis=0, where=kept, dtype=np.float64) / number
    mean = np.where(counts > 0, median.astype(np.float64) + shift, np.nan)
    return mean, np.where(counts > 0, np.sqrt(variance), np.nan), deviations


def _median(stack: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Median over the first axis of the finite samples (NaN sorts last), float32."""
    ordered = np.sort(stack, axis=0)
    low = np.maximum(counts - 1, 0) // 2
    high = np.minimum(counts // 2, len(stack) - 1)
    pick = [np.take_along_axis(ordered, k[None], axis=0)[0] for k in (low, high)]
    return 0.5 * (pick[0] + pick[1])
