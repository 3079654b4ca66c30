"""What a calibration knows of each pixel of the camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

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
    def load(cls, path: Path, shape: tuple[int, int] | None = None) -> PixelModel:
        """Read a pixels file (NPZ) and check that it is for images of `shape`, where given.

        Raises
        ------
        InputError
            The file is unreadable, incomplete or of another image size.
        """
        try:
            with np.load(path) as data:
                mask, bias, noise = (data[key] for key in ("mask", "bias_m", "noise_m"))
                correlated = float(data["correlated_pixels"])
        except (OSError, KeyError, ValueError, EOFError, BadZipFile) as error:
            raise InputError(f"{path}: not a pixels file ({error}); calibrate again") from error
        if mask.ndim != 2 or not mask.shape == bias.shape == noise.shape:
            raise InputError(f"{path}: its images differ in size; calibrate again")
        if shape is not None and mask.shape != shape:
            made, has = (f"{s[1]}×{s[0]}" for s in (mask.shape, shape))
            raise InputError(f"{path}: made for {made} pixels, camera has {has}; calibrate again")
        return cls(mask.astype(bool), bias.astype(float), noise.astype(float), correlated)
