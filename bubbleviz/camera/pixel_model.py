"""Per-pixel calibration of the depth camera: mask, bias, noise and range correction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import as_input_error, plain_numbers, read_npz
from bubbleviz.wording import width_by_height

NOISES_M = 1e-9, 1.0  # σ of a pixel
FARTHEST_OFF_M = 1.0  # bias of a pixel

_MICROMETRE = 1e-6
"""Step of the stored images: far below the noise, and it makes them compress to a third."""
_LINE_IMAGES = ("slope", "rest_m", "nearest_m", "farthest_m")


@dataclass(frozen=True)
class RangeLine:
    """How the error of each pixel changes with range, by several inflation levels; all (H, W)."""

    slope: np.ndarray  # true change of range per measured one
    rest_m: np.ndarray  # measured range of the untouched sensor, where `bias_m` holds, m
    # nearest_m, farthest_m: measured ranges between which the line holds, m
    nearest_m: np.ndarray
    farthest_m: np.ndarray
    levels: int  # inflation levels it was fitted to (scalar)

    def straighten(self, range_m: np.ndarray) -> np.ndarray:
        """Range (H, W) in m with its change from rest corrected; the error at rest remains.

        Lines are not extrapolated: beyond the levels, the error is that of the nearest one. It is
        not NaN, so that deep presses stay visible.
        """
        within = np.clip(range_m, self.nearest_m, self.farthest_m)
        return range_m + (self.slope - 1.0) * (within - self.rest_m)

    def typical(self, mask: np.ndarray) -> tuple[float, float, float]:
        """Median and spread of the slopes, and median span of the line, m, over some pixels."""
        span_m = (self.farthest_m - self.nearest_m)[mask]
        slope = self.slope[mask]
        return float(np.median(slope)), float(np.std(slope)), float(np.median(span_m))

    def at(self, pixels: np.ndarray) -> RangeLine:
        """The line of some pixels, by their flat indices; arrays (k,) in single precision."""
        some = (getattr(self, name).ravel()[pixels].astype(np.float32) for name in _LINE_IMAGES)
        slope, rest, nearest, farthest = some
        return RangeLine(slope, rest, nearest, farthest, self.levels)


@dataclass(frozen=True)
class PixelModel:
    """Mask, bias and noise of each pixel, all (H, W)."""

    mask: np.ndarray  # bool, pixels to use
    bias_m: np.ndarray  # measured minus modelled range of the untouched sensor, m
    noise_m: np.ndarray  # standard deviation σ of the range, m
    # number of pixels per independent sample, as the camera filters (scalar)
    correlated_pixels: float = 1.0
    line: RangeLine | None = None  # None: the bias is the same at every range
    # number of pixels excluded by each reason; the first that applies counts
    removed: dict[str, int] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write a pixels file, a compressed NPZ of half-precision images; `load` reads it."""
        images: dict[str, Any] = {"mask": self.mask}
        for name in ("bias_m", "noise_m"):
            images[name] = np.rint(getattr(self, name) / _MICROMETRE) * _MICROMETRE
            images[name] = images[name].astype(np.float16)
        if self.line is not None:
            images |= {name: getattr(self.line, name).astype(np.float32) for name in _LINE_IMAGES}
            images["levels"] = np.int64(self.line.levels)
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                correlated_pixels=np.float32(self.correlated_pixels),
                removed_reasons=np.array(list(self.removed), dtype=str),
                removed_pixels=np.array(list(self.removed.values()), dtype=np.int64),
                **images,
            )

    @classmethod
    def load(cls, path: Path, shape: tuple[int, int] | None = None) -> PixelModel:
        """Read a pixels file (NPZ) and check that it is for images of `shape`, where given.

        Raises InputError: the file is unreadable, incomplete or of another image size.
        """
        with as_input_error(path, "the pixels file", "identify the sensor again"):
            data = read_npz(path)
            mask, bias, noise = (plain_numbers(data[key]) for key in ("mask", "bias_m", "noise_m"))
            correlated = float(plain_numbers(data["correlated_pixels"]))
            line = _line(data)
        same = {mask.shape, bias.shape, noise.shape}
        if line is not None:
            same |= {line.slope.shape, line.rest_m.shape}
            same |= {line.nearest_m.shape, line.farthest_m.shape}
        if mask.ndim != 2 or len(same) > 1:
            raise InputError(f"{path}: its images differ in size; identify the sensor again")
        if shape is not None and mask.shape != shape:
            made, has = map(width_by_height, (mask.shape, shape))
            raise InputError(
                f"{path}: made for {made} pixels but the camera has {has}; identify the sensor "
                "again"
            )
        used = mask.astype(bool)
        if not (
            (np.abs(bias[used]) < FARTHEST_OFF_M).all()
            and (noise[used] >= NOISES_M[0]).all()
            and (noise[used] <= NOISES_M[1]).all()
            and 0.0 < correlated < mask.size + 1.0
            and (line is None or np.isfinite(line.straighten(bias)[used]).all())
        ):
            raise InputError(
                f"{path}: bias or noise of a pixel, or their correlation, is not finite or out of "
                "range; identify the sensor again"
            )
        return cls(used, bias, noise, correlated, line)

    def at(self, pixels: np.ndarray) -> PixelModel:
        """Calibration of some pixels, by their flat indices; arrays (k,)."""
        mask, bias, noise = (x.ravel()[pixels] for x in (self.mask, self.bias_m, self.noise_m))
        line = None if self.line is None else self.line.at(pixels)
        return PixelModel(mask, bias, noise, self.correlated_pixels, line)

    def corrected(self, range_m: np.ndarray) -> np.ndarray:
        """Measured range (H, W) corrected by line and bias, m; NaN in excluded pixels."""
        straight = range_m if self.line is None else self.line.straighten(range_m)
        return np.where(self.mask, straight - self.bias_m, np.nan)


def _line(data: Mapping[str, np.ndarray]) -> RangeLine | None:
    """The line in a pixels file, where it has one."""
    if "slope" not in data:
        return None
    slope, rest, nearest, farthest = (plain_numbers(data[name]) for name in _LINE_IMAGES)
    return RangeLine(slope, rest, nearest, farthest, int(data["levels"]))


# The pixels that see the membrane, with their calibration: depth image to range residuals.


@dataclass(frozen=True)
class UsedPixels:
    """Pixels in use, all (k,)."""

    number: np.ndarray  # int, flat indices in the image
    block: np.ndarray  # int, block that each is in
    scale: np.ndarray  # float32, range per z-depth
    reference_m: np.ndarray  # float32, range of the untouched membrane as this pixel measures it, m
    precision: np.ndarray  # float32, 1/σ², 1/m²
    line: RangeLine | None  # how its error changes with range

    def of(self, some: np.ndarray) -> UsedPixels:
        """Pixels number `some` (j,)."""
        arrays = {name: array[some] for name, array in vars(self).items() if name != "line"}
        return UsedPixels(**arrays, line=None if self.line is None else self.line.at(some))

    def residuals(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured minus reference range in a z-depth image (H, W), (k,), m; NaN: no return."""
        depths = depth_m.ravel().take(self.number, mode="clip")  # unchecked: all indices are valid
        ranges = depths * self.scale  # not in place: images have any type
        if self.line is not None:
            ranges = self.line.straighten(ranges)
        ranges -= self.reference_m
        return ranges

    def squared_residuals(self, depth_m: np.ndarray, expected_m: np.ndarray) -> np.ndarray:
        """Squared residuals to a model (B,) of the blocks, in σ², (k,); NaN: no return."""
        squares = self.residuals(depth_m)
        squares -= expected_m[self.block]
        squares *= squares
        squares *= self.precision
        return squares
