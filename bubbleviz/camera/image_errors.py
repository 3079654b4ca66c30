"""Errors of a whole depth image, which change with a camera's temperature or its mounting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

IMAGE_ERRORS = ("offset", "tilt to the right", "tilt downwards", "scale")
"""An offset, in m; offsets that grow with the tangent of the angle off the optical axis, in m; and
a share of the depth."""


@dataclass(frozen=True)
class ImageErrors:
    """Normal distribution of the amplitudes of `IMAGE_ERRORS`.

    Attributes
    ----------
    mean : (4,) array
    covariance : (4, 4) array
    prior : ImageErrors or None
        Before the image that this is estimated from.
    """

    mean: np.ndarray
    covariance: np.ndarray
    prior: ImageErrors | None = None

    @cached_property
    def units(self) -> np.ndarray:
        """Combinations of errors, a column each, whose amplitudes are independent, (4, 4).

        Their standard deviations are 1.
        """
        variance, axes = np.linalg.eigh(self.covariance)
        return axes * np.sqrt(np.maximum(variance, 0.0))

    def at(self, amplitudes: np.ndarray) -> np.ndarray:
        """Errors (4,) for amplitudes (4,) of the `units`."""
        errors: np.ndarray = self.mean + self.units @ amplitudes
        return errors

    def given(self, amplitudes: np.ndarray, covariance: np.ndarray, widened: float) -> ImageErrors:
        """Distribution after an image, by the amplitudes of the `units` and their covariance.

        `widened`: factor of the standard deviations with which this was the image's prior.
        """
        prior = ImageErrors(self.mean, widened**2 * self.covariance)
        return ImageErrors(self.at(amplitudes), self.units @ covariance @ self.units.T, prior)
