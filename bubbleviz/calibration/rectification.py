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
_MIN_SPAN = 10.0  # standard deviations of a sample by which levels must differ


def rectify(
    found: Identification,
    levels: Sequence[Identification],  # of the untouched sensor at other inflations, with surfaces
) -> Identification:
    """Identification with a range correction per pixel, fitted to further inflation levels.

    The bias stays that of the rest level, so that the untouched sensor shows no contact. Pixels
    without a measurement at every level are not used.

    Raises InputError: images of different sizes, or levels too close to determine a slope.
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
    )
    pixels, known = found.pixels, np.isfinite(slope)
    mask = pixels.mask & known
    lost = int(np.count_nonzero(pixels.mask & ~known))
    line = RangeLine(
        slope=np.where(mask, slope, 1.0),
        rest_m=np.where(mask, found.samples.statistics.range_m, 0.0),
        nearest_m=np.where(mask, nearest, 0.0),
        farthest_m=np.where(mask, farthest, 0.0),
        levels=len(every),
    )
    return replace(
        found,
        pixels=replace(
            pixels,
            mask=mask,
            bias_m=np.where(mask, pixels.bias_m, 0.0).astype(np.float32),
            noise_m=np.where(mask, pixels.noise_m, np.inf).astype(np.float32),
            removed=pixels.removed | {"not_at_every_level": lost},
            line=line,
        ),
    )


def fit_lines(
    # (L, H, W), mean measured range, and range of the surface fitted to it, m; NaN: none
    measured_m: np.ndarray,
    modelled_m: np.ndarray,
    noise_m: np.ndarray,  # (L, H, W), standard deviation of one sample, m
    frames: np.ndarray,  # (L,), effective number of independent frames in a mean
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slope of true over measured range, and ranges (m) between which it is valid, (H, W) each.

    Each level is weighted by its noise. Towards the rim levels differ little, so slopes are shrunk
    towards 1 according to their standard error: the posterior mean under a prior whose spread is
    that of the slopes of the better half of the pixels. NaN where unknown.
    """
    nearest, farthest, noise = measured_m.min(axis=0), measured_m.max(axis=0), noise_m.max(axis=0)
    _check_apart(farthest - nearest, noise)
    with np.errstate(invalid="ignore", divide="ignore"):
        precision = frames[:, None, None] / noise_m**2
        weights = precision / precision.sum(axis=0)
        x, y = (np.sum(weights * image, axis=0) for image in (measured_m, modelled_m))
        lever = np.sum(weights * (measured_m - x) ** 2, axis=0)
        change = np.sum(weights * (measured_m - x) * (modelled_m - y), axis=0) / lever - 1.0
        sigma = 1.0 / np.sqrt(lever * precision.sum(axis=0))
        margin = _TOLERANCE * noise
    known = np.isfinite(change)
    better = known & (sigma <= np.median(sigma[known]))
    spread = robust_sigma(change[better], center=0.0) ** 2 - float(np.mean(sigma[better] ** 2))
    prior = max(spread, 0.0)
    slope = 1.0 + change * prior / np.maximum(prior + sigma**2, 1e-300)
    return slope, nearest - margin, farthest + margin


def _check_apart(span_m: np.ndarray, noise_m: np.ndarray) -> None:
    known = np.isfinite(span_m) & np.isfinite(noise_m)
    if not known.any():
        raise InputError(
            "rectification: no pixel is valid at every level; record the levels with the membrane "
            "in view"
        )
    span, needed = float(np.median(span_m[known])), _MIN_SPAN * float(np.median(noise_m[known]))
    if span < needed:
        raise InputError(
            f"rectification: the membrane moves only {1e3 * span:.2g} mm between the levels; "
            f"inflate them at least {1e3 * needed:.2g} mm apart, which the noise requires"
        )
