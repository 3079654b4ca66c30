"""Errors of a whole depth image, which change with a camera's temperature or its mounting."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

IMAGE_ERRORS = (
    "offset",
    "tilt to the right",
    "tilt downwards",
    "scale",
    "shift to the right",
    "shift downwards",
)
"""An offset, in m; offsets that grow with the tangent of the angle off the optical axis, in m; a
share of the depth; and motion of the camera across its optical axis, in m."""
OF_RANGES, SHIFTS = slice(4), slice(4, 6)
"""Errors that are the same on every surface, and shifts, whose effect depends on its slope."""

SQUARE_ERROR_M = 6e-5
"""σ of the mean error that a correct model leaves in a square of the image, besides that of its
facets. Chosen: twice the rms of such means, 0.03 mm, on the real press while it is held."""


def camera_shift(errors: np.ndarray) -> np.ndarray:
    """Shifts (2,) of a camera that has moved, by errors (e,) of its image, m; else 0.

    Those within the error that a correct model leaves are no motion: first order is enough.
    """
    shift_m: np.ndarray = errors[SHIFTS]
    return shift_m if np.abs(shift_m).max() > SQUARE_ERROR_M else np.zeros(2)


def range_errors(T_B_C: np.ndarray, rays: np.ndarray, range_m: np.ndarray) -> np.ndarray:
    """Errors (r, 4) of ranges under a unit of each of `IMAGE_ERRORS` but shifts.

    Parameters
    ----------
    T_B_C : (4, 4) array
        Pose of the camera.
    rays : (r, 3) array
        Unit vectors in B.
    range_m : (r,) array
        Ranges along them, m.
    """
    right, down, forward = T_B_C[:3, :3].T @ rays.T
    return np.column_stack([1.0 / forward, right / forward**2, down / forward**2, range_m])


def range_shifts(T_B_C: np.ndarray, rays: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Errors (r, 2) of ranges under a unit of each of the shifts, to first order.

    Parameters
    ----------
    T_B_C : (4, 4) array
        Pose of the camera.
    rays : (r, 3) array
        Unit vectors in B.
    normals : (r, 3) array
        Normals of the surface where they meet it, of any length.
    """
    along = np.einsum("ri,ri->r", normals, rays)
    shifts: np.ndarray = -normals @ T_B_C[:3, :2] / along[:, None]
    return shifts


@dataclass(frozen=True, eq=False)
class ImageErrors:
    """Normal distribution of the amplitudes of `IMAGE_ERRORS`.

    Attributes
    ----------
    mean : (e,) array
    covariance : (e, e) array
        Due to noise, and drift since they were determined.
    by_model : (e, e) array
        Covariance due to errors of the model, which are the same in every image.
    prior : ImageErrors or None
        Distribution before the image from which this one is estimated.
    """

    mean: np.ndarray
    covariance: np.ndarray
    prior: ImageErrors | None = None
    by_model: np.ndarray = field(default_factory=lambda: np.zeros((len(IMAGE_ERRORS),) * 2))

    @cached_property
    def units(self) -> np.ndarray:
        """Combinations of errors, a column each, whose amplitudes are independent, (e, e).

        Their standard deviations are 1.
        """
        variance, axes = np.linalg.eigh(self.covariance)
        return axes * np.sqrt(np.maximum(variance, 0.0))

    @cached_property
    def precision(self) -> np.ndarray:
        """Inverse of the covariance, (e, e); 0 for errors that are excluded."""
        return np.linalg.pinv(self.covariance, hermitian=True)

    def widened(self, factor: float) -> ImageErrors:
        """The same with standard deviations times a factor."""
        return replace(self, covariance=factor**2 * self.covariance, prior=None)

    def displacement_covariance(self, T_B_C: np.ndarray) -> np.ndarray:
        """Covariance (3, 3) of the place in B of all that the camera at a pose sees, m².

        Only what is unknown of the camera's shifts, not of its turns.
        """
        covariance = (self.covariance + self.by_model)[SHIFTS, SHIFTS]
        across = T_B_C[:3, :2]
        placed: np.ndarray = across @ covariance @ across.T
        return placed
