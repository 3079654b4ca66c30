"""Per-pixel rectification of the range: an offset from one inflation level, a line from more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bubbleviz.calibration.identify import Identification
from bubbleviz.errors import InputError

_TOLERANCE = 3.0  # standard deviations of a sample at the outermost level
_APART = 10.0  # standard deviations of a sample that levels must differ by


@dataclass(frozen=True)
class Level:
    """What one inflation level says of every pixel.

    Attributes
    ----------
    measured_m, modelled_m : (H, W) array
        Mean range along the ray, and that of the surface fitted to it, m; NaN: none.
    noise_m : (H, W) array
        Standard deviation of one sample, m.
    """

    measured_m: np.ndarray
    modelled_m: np.ndarray
    noise_m: np.ndarray

    @classmethod
    def of(cls, found: Identification) -> Level:
        """Level of an identified recording; only pixels in use."""
        mask = found.pixels.mask
        return cls(
            measured_m=np.where(mask, found.statistics.range_m, np.nan),
            modelled_m=np.where(mask, found.modelled_range_m, np.nan),
            noise_m=found.pixels.noise_m,
        )


@dataclass(frozen=True)
class Rectification:
    """Rectified range = offset_m + slope × measured range, within what was measured.

    Attributes
    ----------
    offset_m, slope : (H, W) array
        NaN where nothing is known.
    nearest_m, farthest_m : (H, W) array
        Measured ranges between which the line holds, m; from one level alone there is no line
        and so no limit: −inf and inf.
    levels : int
    """

    offset_m: np.ndarray
    slope: np.ndarray
    nearest_m: np.ndarray
    farthest_m: np.ndarray
    levels: int

    def apply(self, range_m: np.ndarray) -> np.ndarray:
        """Rectified range (H, W), m; NaN beyond the levels: a line must not be extrapolated."""
        with np.errstate(invalid="ignore"):
            inside = (range_m >= self.nearest_m) & (range_m <= self.farthest_m)
        return np.where(inside, self.offset_m + self.slope * range_m, np.nan)


def fit_rectification(levels: Sequence[Level]) -> Rectification:
    """Fit every pixel's line through the levels, each weighted by its noise.

    Raises
    ------
    InputError
        No level, images of different sizes, or levels too alike to tell a slope.
    """
    if not levels:
        raise InputError("rectification: no inflation level; give at least one recording")
    if len({level.measured_m.shape for level in levels}) > 1:
        raise InputError("rectification: images differ in size; give recordings of one camera")
    measured = np.stack([level.measured_m for level in levels])
    modelled = np.stack([level.modelled_m for level in levels])
    noise = np.stack([level.noise_m for level in levels])
    if len(levels) == 1:
        everywhere = np.full(measured.shape[1:], np.inf)
        offset = (modelled - measured)[0]
        slope = np.where(np.isfinite(offset), 1.0, np.nan)
        return Rectification(offset, slope, -everywhere, everywhere, 1)
    nearest, farthest = measured.min(axis=0), measured.max(axis=0)
    _check_apart(farthest - nearest, noise.max(axis=0))
    with np.errstate(invalid="ignore", divide="ignore"):
        weights = 1.0 / noise**2
        weights /= weights.sum(axis=0)
        x, y = (np.sum(weights * image, axis=0) for image in (measured, modelled))
        slope = np.sum(weights * (measured - x) * (modelled - y), axis=0)
        slope /= np.sum(weights * (measured - x) ** 2, axis=0)
        margin = _TOLERANCE * noise.max(axis=0)
    return Rectification(y - slope * x, slope, nearest - margin, farthest + margin, len(levels))


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
