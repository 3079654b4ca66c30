"""Per-pixel rectification of the range: an offset from one inflation level, a line from more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.calibration.contact_free import check_still, find_contact_free
from bubbleviz.calibration.identification import Identification, check_dome
from bubbleviz.calibration.rest_frames import Samples, collect, select_pixels
from bubbleviz.calibration.surface import fit_surfaces
from bubbleviz.camera import RangeLine
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import FrameSource, robust_sigma
from bubbleviz.sensor import Sensor

_TOLERANCE = 3.0  # standard deviations of a sample at the outermost level
_APART = 10.0  # standard deviations of a sample that levels must differ by


@dataclass(frozen=True)
class Level:
    """Measured and modelled range of every pixel at one inflation level."""

    # measured_m, modelled_m: (H, W), mean range along the ray, and that of the surface fitted to
    # it, m; NaN: none
    measured_m: np.ndarray
    modelled_m: np.ndarray
    noise_m: np.ndarray  # (H, W), standard deviation of one sample, m
    frames: float = 1.0  # independent samples that the mean is worth
    # what it was measured on, for what inflation tells of the rubber
    samples: Samples | None = None

    @classmethod
    def of(cls, found: Identification) -> Level:
        """Level of an identified recording; only pixels in use."""
        mask = found.pixels.mask
        return cls(
            measured_m=np.where(mask, found.statistics.range_m, np.nan),
            modelled_m=np.where(mask, found.modelled_range_m, np.nan),
            noise_m=found.pixels.noise_m,
            frames=found.statistics.effective_frames,
            samples=found.samples,
        )

    @classmethod
    def measure(
        cls, source: FrameSource, sensor: Sensor, nodes: int = 1000, progress: Progress = quiet
    ) -> Level:
        """Level of a recording that begins untouched; its gauge pressure need not be known.

        Raises InputError: as in `identify`.
        """
        chosen = find_contact_free(source, progress).frames
        samples = collect(source, sensor, chosen, progress)
        check_still(samples)
        surfaces = fit_surfaces(samples, nodes, progress=progress)
        check_dome(samples, surfaces)
        pixels = select_pixels(samples.statistics, surfaces.membrane, surfaces.residual_m)
        measured = np.where(pixels.mask, samples.statistics.range_m, np.nan)
        return cls(
            measured,
            measured - surfaces.residual_m,
            pixels.noise_m,
            samples.statistics.effective_frames,
            samples,
        )


@dataclass(frozen=True)
class Lines:
    """Change of true range per change of measured range in each pixel, within what was measured."""

    # slope, slope_sigma: (H, W), with its standard error; NaN where nothing is known
    slope: np.ndarray
    slope_sigma: np.ndarray
    # nearest_m, farthest_m: (H, W), measured ranges between which the line holds, m
    nearest_m: np.ndarray
    farthest_m: np.ndarray


def fit_lines(levels: Sequence[Level]) -> Lines:
    """Fit every pixel's line through two or more levels, each weighted by its noise.

    Raises InputError: images of different sizes, or levels too alike to tell a slope.
    """
    if len({level.measured_m.shape for level in levels}) > 1:
        raise InputError("rectification: images differ in size; give recordings of one camera")
    measured = np.stack([level.measured_m for level in levels])
    modelled = np.stack([level.modelled_m for level in levels])
    noise = np.stack([level.noise_m for level in levels])
    nearest, farthest = measured.min(axis=0), measured.max(axis=0)
    _check_apart(farthest - nearest, noise.max(axis=0))
    frames = np.array([level.frames for level in levels])[:, None, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        precision = frames / noise**2
        weights = precision / precision.sum(axis=0)
        x, y = (np.sum(weights * image, axis=0) for image in (measured, modelled))
        lever = np.sum(weights * (measured - x) ** 2, axis=0)
        slope = np.sum(weights * (measured - x) * (modelled - y), axis=0) / lever
        sigma = 1.0 / np.sqrt(lever * precision.sum(axis=0))
        margin = _TOLERANCE * noise.max(axis=0)
    return Lines(slope, sigma, nearest - margin, farthest + margin)


def _steady_slope(fitted: Lines) -> np.ndarray:
    """Slopes (H, W) shrunk towards 1 according to their standard error; NaN where unknown.

    Towards the rim the levels differ by little. The mean of the posterior, with the slopes'
    own spread over the better half of the pixels as the prior's.
    """
    known = np.isfinite(fitted.slope)
    change, sigma = fitted.slope - 1.0, fitted.slope_sigma
    better = known & (sigma <= np.median(sigma[known]))
    spread = robust_sigma(change[better], center=0.0) ** 2 - float(np.mean(sigma[better] ** 2))
    prior = max(spread, 0.0)
    steady: np.ndarray = 1.0 + change * prior / np.maximum(prior + sigma**2, 1e-300)
    return steady


def rectify(found: Identification, levels: Sequence[Level]) -> Identification:
    """Identification with a range correction per pixel fitted to further inflation levels.

    The bias stays that of its own level, so that the untouched sensor shows no contact; pixels
    that are not seen at every level are left out.

    Raises InputError: as `fit_lines`.
    """
    if not levels:
        return found
    fitted = fit_lines([Level.of(found), *levels])
    pixels, slope = found.pixels, _steady_slope(fitted)
    known = np.isfinite(slope)
    mask = pixels.mask & known
    lost = int(np.count_nonzero(pixels.mask & ~known))
    line = RangeLine(
        slope=np.where(mask, slope, 1.0),
        rest_m=np.where(mask, found.statistics.range_m, 0.0),
        nearest_m=np.where(mask, fitted.nearest_m, 0.0),
        farthest_m=np.where(mask, fitted.farthest_m, 0.0),
        levels=len(levels) + 1,
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


def _check_apart(span_m: np.ndarray, noise_m: np.ndarray) -> None:
    known = np.isfinite(span_m) & np.isfinite(noise_m)
    if not known.any():
        raise InputError("rectification: no pixel is seen at every level; record them again")
    span, needed = float(np.median(span_m[known])), _APART * float(np.median(noise_m[known]))
    if span < needed:
        raise InputError(
            f"rectification: the levels are only {1e3 * span:.2g} mm apart, within the noise;"
            f" inflate to levels {1e3 * needed:.2g} mm apart or more, or use one of them"
        )
