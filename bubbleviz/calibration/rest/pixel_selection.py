"""Pixel selection: which pixels to use, with the bias and noise of each."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.calibration.rest.depth_statistics import DepthStatistics
from bubbleviz.calibration.robust_statistics import robust_sigma, upper_fence
from bubbleviz.calibration.surface.segmentation import away_from_edges
from bubbleviz.camera.pixel_model import PixelModel

_MICROMETRE = 1e-6
"""Step of the stored images: far below the noise, and it makes them compress to a third."""

_SAMPLE_SCALE = 3.0  # robust standard deviations: 1 in 370 of a normal population lies outside


@dataclass(frozen=True)
class PixelStatistics(PixelModel):
    """Bias and noise of each pixel from contact-free frames; bias 0 and noise inf outside the mask.

    Attributes
    ----------
    removed : dict of str to int
        Pixels that each reason removed; the first that applies counts.
    """

    removed: dict[str, int] = field(default_factory=dict)

    def save(self, path: str | Path) -> None:
        """Write the sensor file's `pixels_file`, a compressed NPZ of half-precision images.

        `PixelModel.load` reads it.
        """
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file,
                mask=self.mask,
                bias_m=_half(self.bias_m),
                noise_m=_half(self.noise_m),
                correlated_pixels=np.float32(self.correlated_pixels),
                removed_reasons=np.array(list(self.removed), dtype=str),
                removed_pixels=np.array(list(self.removed.values()), dtype=np.int64),
                **self._line_images(),
            )

    def _line_images(self) -> dict[str, Any]:
        if self.line is None:
            return {}
        images = {
            name: getattr(self.line, name).astype(np.float32)
            for name in ("slope", "rest_m", "nearest_m", "farthest_m")
        }
        return images | {"levels": np.int64(self.line.levels)}


def select_pixels(
    statistics: DepthStatistics,
    membrane: np.ndarray,
    residual_m: np.ndarray,
    min_validity: float | None = None,
    deviations: float = _SAMPLE_SCALE,
) -> PixelStatistics:
    """Choose the pixels to use, and estimate the bias of each.

    Reasons to leave a pixel out, in this order: `never_valid` and `rarely_valid` (returns in
    fewer than `min_validity` of the frames), `false_return` (not part of the membrane),
    `outside_rim` (its ray misses the membrane), `edge` (its matching window reaches past the
    membrane's edge or into a hole), `unstable` (σ beyond what the other pixels have) and
    `biased` (glare and rim bias: further from the surface than the other pixels are).

    Parameters
    ----------
    statistics : DepthStatistics
        Of the contact-free frames.
    membrane : (H, W) bool array
        Pixels that see the membrane (`segment.membrane_pixels`).
    residual_m : (H, W) array
        Measured minus modelled range, m; NaN where the ray misses the model.
    min_validity : float, optional
        Share of the frames in which a pixel must have a return; nine tenths of what is usual.
    deviations : float
        Robust standard deviations beyond which a pixel is `unstable` or `biased`.
    """
    if min_validity is None:
        min_validity = statistics.regular_validity
    validity, sigma = statistics.validity, statistics.noise_m
    inner = away_from_edges(membrane, 0.5 * statistics.correlation_length_px)
    typical = membrane & np.isfinite(residual_m)
    fence = upper_fence(sigma[typical], deviations)
    middle = float(np.median(residual_m[typical])) if typical.any() else 0.0
    spread = robust_sigma(residual_m[typical])
    # NaN compares false: what has no residual was taken out by an earlier reason.
    with np.errstate(invalid="ignore"):
        reasons = {
            "never_valid": validity <= 0.0,
            "rarely_valid": validity < min_validity,
            "false_return": ~membrane,
            "outside_rim": ~np.isfinite(residual_m),
            "edge": ~inner,
            "unstable": ~(sigma <= fence),
            "biased": np.abs(residual_m - middle) > deviations * spread,
        }
    mask = np.ones(validity.shape, bool)
    removed = {}
    for name, out in reasons.items():
        removed[name] = int(np.count_nonzero(mask & out))
        mask &= ~out
    return PixelStatistics(
        mask=mask,
        bias_m=np.where(mask, residual_m, 0.0).astype(np.float32),
        noise_m=np.where(mask, sigma, np.inf).astype(np.float32),
        removed=removed,
        correlated_pixels=statistics.correlated_pixels,
    )


def _half(image: np.ndarray) -> np.ndarray:
    """Image in m rounded to micrometres, half precision."""
    return (np.rint(image / _MICROMETRE) * _MICROMETRE).astype(np.float16)
