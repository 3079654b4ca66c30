"""The pixels that see the membrane, with what is known of each: depth image to range residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.camera.pixel_model import RangeLine


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
        return UsedPixels(
            self.number[some],
            self.block[some],
            self.scale[some],
            self.reference_m[some],
            self.precision[some],
            None if self.line is None else self.line.at(some),
        )

    def residuals(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured minus reference range in a z-depth image (H, W), (k,), m; NaN: no return."""
        depths = depth_m.ravel().take(self.number, mode="clip")  # unchecked: all are inside
        ranges = depths * self.scale  # not in place: images of any type come
        if self.line is not None:
            ranges = self.line.straighten(ranges)
        ranges -= self.reference_m
        return ranges

    def misses_squared(self, depth_m: np.ndarray, expected_m: np.ndarray) -> np.ndarray:
        """Squares in σ² of what a model (B,) of the blocks leaves, (k,); NaN: no return."""
        left = self.residuals(depth_m)
        left -= expected_m[self.block]
        left *= left
        left *= self.precision
        return left
