"""Images of a frame to look at: what changed, what the model leaves unexplained, what to trust."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from bubbleviz.camera.membrane_view import MembraneView
from bubbleviz.camera.pixel_model import PixelModel


class FrameImages:
    """Makes images (H, W) from a depth image, at full resolution.

    Parameters
    ----------
    view : MembraneView
    noise_relative : float
        σ of range per range, where no pixel calibration says more.
    pixels : PixelModel or None
    """

    def __init__(
        self, view: MembraneView, noise_relative: float, pixels: PixelModel | None
    ) -> None:
        self._view, self._camera = view, view.camera
        self._noise_relative, self._pixels = noise_relative, pixels

    def change(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured less reference range, m: negative where the membrane is pushed in."""
        return self._range(depth_m) - self._reference

    def residual(self, depth_m: np.ndarray, displacement_m: np.ndarray) -> np.ndarray:
        """Measured less modelled range, m; NaN where either is missing."""
        return self._range(depth_m) - self._biased(self._view.range_image(displacement_m))

    def used(self, depth_m: np.ndarray) -> np.ndarray:
        """Whether a pixel sees the membrane, has a return and is trusted, bool."""
        return np.isfinite(depth_m) & np.isfinite(self._reference)

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation σ of the range, m; NaN off the membrane and where not trusted."""
        if self._pixels is not None:
            return np.where(self._pixels.mask, self._pixels.noise_m, np.nan)
        return self._noise_relative * self._reference

    @cached_property
    def _reference(self) -> np.ndarray:
        rest = np.zeros(len(self._view.mesh.nodes))
        return self._biased(self._view.range_image(rest))

    def _biased(self, range_m: np.ndarray) -> np.ndarray:
        """Model of what the camera says of a range: the bias of each pixel is part of it."""
        if self._pixels is None:
            return range_m
        return range_m + np.where(self._pixels.mask, self._pixels.bias_m, np.nan)

    def _range(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured range, straight where it was calibrated at several inflation levels, m."""
        ranges = self._camera.range_image(depth_m)
        return ranges if self._pixels is None else self._pixels.straightened(ranges)
