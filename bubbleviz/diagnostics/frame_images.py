"""Diagnostic images of a frame: change, residual, noise, pixels used."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from bubbleviz.sensor_model import SensorModel


class FrameImages:
    """Makes images (H, W) from a depth image, at full resolution.

    Parameters
    ----------
    model : SensorModel
    """

    def __init__(self, model: SensorModel) -> None:
        self._model = model

    def change(self, depth_m: np.ndarray) -> np.ndarray:
        """Measured less reference range, m: negative where the membrane is pushed in."""
        return self._model.range_image(depth_m) - self._reference

    def residual(self, depth_m: np.ndarray, displacement_m: np.ndarray) -> np.ndarray:
        """Measured less modelled range, m; NaN where either is missing."""
        return self._model.range_image(depth_m) - self._model.view.range_image(displacement_m)

    def used(self, depth_m: np.ndarray) -> np.ndarray:
        """Whether a pixel sees the membrane, has a return and is trusted, bool."""
        return np.isfinite(self._model.range_image(depth_m)) & np.isfinite(self._reference)

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation σ of the range, m; NaN off the membrane and where not trusted."""
        pixels = self._model.pixels
        if pixels is not None:
            return np.where(pixels.mask, pixels.noise_m, np.nan)
        return self._model.sensor.camera.noise_relative * self._reference

    @cached_property
    def _reference(self) -> np.ndarray:
        return self._model.view.range_image(np.zeros(len(self._model.mesh.nodes)))
