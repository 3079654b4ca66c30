"""Errors of a whole depth image, which change with a camera's temperature or its mounting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

IMAGE_ERRORS = ("offset", "tilt to the right", "tilt downwards", "scale")
"""An offset, in m; offsets that grow with the tangent of the angle off the optical axis, in m; and
a share of the depth."""


@dataclass(frozen=True, eq=False)
class ImageErrors:
    """Normal distribution of the amplitudes of `IMAGE_ERRORS`.

    Attributes
    ----------
    mean : (4,) array
    covariance : (4, 4) array
    prior : ImageErrors or None
        Distribution before the image from which this one is estimated.
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

    @cached_property
    def precision(self) -> np.ndarray:
        """Inverse of the covariance, (4, 4)."""
        return np.linalg.inv(self.covariance)

    def widened(self, factor: float) -> ImageErrors:
        """The same with standard deviations times a factor."""
        return ImageErrors(self.mean, factor**2 * self.covariance)
