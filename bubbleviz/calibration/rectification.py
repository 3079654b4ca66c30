"""Per-pixel correction of the range: an offset from one inflation level, a line from several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bubbleviz.calibration.identification import Identification
from bubbleviz.camera import RangeLine
from bubbleviz.errors import InputError
from bubbleviz.recordings import robust_sigma

_TOLERANCE = 3.0  # standard deviations of a sample beyond the outermost levels
_LARGEST_SPREAD = 0.1
"""Largest standard deviation of pixels' gains that the fit accepts; chosen: gains of depth cameras
differ by a few percent. A pixel five times as far from 1 is stuck, or sees something else."""


def rectify(
    found: Identification,
    levels: Sequence[Identification],  # of the untouched sensor at other inflations, with surfaces
) -> Identification:
    """Identification with a range correction per pixel, fitted to further inflation levels.

    The bias stays that of the rest level, so that the untouched sensor shows no contact. Pixels
    without a measurement at every level are not used.

    Raises InputError: images of different sizes, or no pixel measured at every level.
    """
    if not levels:
        return found
    every = [found, *levels]
    if len({each.pixels.mask.shape for each in every}) > 1:
        raise InputError(
            "rectification: recording and inflation levels differ in image size; record all with "
            "one camera and resolution"
        )
    mask = np.stack([each.pixels.mask for each in every])
    slope, nearest, farthest = fit_lines(
        np.where(mask, np.stack([each.samples.statistics.range_m for each in every]), np.nan),
        np.where(mask, np.stack([each.modelled_range_m for each in every]), np.nan),
        np.stack([each.pixels.noise_m for each in every]),
        np.array([each.samples.statistics.effective_frames for each in every]),
        max(each.samples.statistics.quantum_m for each in every),
    )
    pixels, known = found.pixels, np.isfinite(slope)
    mask = pixels.mask & known
    lost = int(np.count_nonzero(pixels.mask & ~known))
    images = slope, found.samples.statistics.range_m, nearest, farthest
    slope, rest, nearest, farthest = (np.where(mask, image, np.nan) for image in images)
    line = RangeLine(slope, rest, nearest, farthest, len(every))
    removed = pixels.removed | {"not_at_every_level": lost}
    return replace(found, pixels=replace(pixels, mask=mask, removed=removed, line=line))


def fit_lines(
    # (L, H, W), mean measured range, and range of the surface fitted to it, m; NaN: none
    measured_m: np.ndarray,
    modelled_m: np.ndarray,
    noise_m: np.ndarray,  # (L, H, W), standard deviation of one sample, m
    frames: np.ndarray,  # (L,), effective number of independent frames in a mean
    quantum_m: float = 0.0,  # step of the depth, m; its rounding does not average out over frames
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slope of true over measured range, and ranges (m) between which it is valid, (H, W) each.

    Measured ranges are fitted over modelled ones, which have little noise; each level is weighted
    by its noise. Towards the rim, and where the membrane hardly moves, levels differ little: gains
    are shrunk towards 1 according to their standard error, as the posterior mean under a prior
    whose spread is that of the gains of the better half of the pixels. NaN where unknown, as of a
    pixel that does not follow the membrane.

    Raises InputError: no pixel was measured at every level.
    """
    nearest, farthest, noise = measured_m.min(axis=0), measured_m.max(axis=0), noise_m.max(axis=0)
    precision = 1.0 / (noise_m**2 / frames[:, None, None] + quantum_m**2 / 12.0)
    total = precision.sum(axis=0)
    with np.errstate(invalid="ignore"):
        x, y = (np.sum(precision * image, axis=0) / total for image in (modelled_m, measured_m))
        information = np.sum(precision * (modelled_m - x) ** 2, axis=0)
        score = np.sum(precision * (modelled_m - x) * (measured_m - y), axis=0) - information
    known = np.isfinite(score)
    if not known.any():
        raise InputError(
            "rectification: no pixel is valid at every level; record the levels with the membrane "
            "in view"
        )
    variance = 1.0 / np.maximum(information, 1.0)  # beyond a standard error of 1, nothing is known
    better = known & (variance <= np.median(variance[known]))
    spread = robust_sigma((score * variance)[better], center=0.0) ** 2 - variance[better].mean()
    prior = np.clip(spread, 0.0, _LARGEST_SPREAD**2)
    gain = 1.0 + score * prior / (1.0 + information * prior)
    slope = 1.0 / np.where(np.abs(gain - 1.0) < 5.0 * _LARGEST_SPREAD, gain, np.nan)
    margin = _TOLERANCE * noise
    return slope, nearest - margin, farthest + margin
