"""What a calibration knows of each pixel of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError


@dataclass(frozen=True)
class PixelModel:
    """Mask, bias and noise of each pixel, all (H, W).

    Attributes
    ----------
    mask : bool array
        Pixels to use.
    bias_m : float array
        Measured minus modelled range of the untouched sensor, m.
    noise_m : float array
        Standard deviation σ of the range, m.
    correlated_pixels : float
        Pixels that are worth one independent sample, because the camera filters (scalar).
    """

    mask: np.ndarray
    bias_m: np.ndarray
    noise_m: np.ndarray
    correlated_pixels: float = 1.0

    @classmethod
    def load(cls, path: Path, shape: tuple[int, int]) -> PixelModel:
        """Read a pixels file (NPZ) and check that it is for images of `shape`.

        Raises
        ------
        InputError
            The file is unreadable, incomplete or of another image size.
        """
        try:
            with np.load(path) as data:
                mask, bias, noise = (data[key] for key in ("mask", "bias_m", "noise_m"))
                correlated = float(data["correlated_pixels"])
        except (OSError, KeyError, ValueError) as error:
            raise InputError(f"{path}: not a pixels file ({error}); calibrate again") from error
        if mask.shape != shape:
            made, has = (f"{s[1]}×{s[0]}" for s in (mask.shape, shape))
            raise InputError(f"{path}: made for {made} pixels, camera has {has}; calibrate again")
        return cls(mask.astype(bool), bias.astype(float), noise.astype(float), correlated)
