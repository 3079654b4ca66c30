"""A nodal field as the camera sees it."""

from __future__ import annotations

import numpy as np

from bubbleviz.camera.membrane_view import MembraneView


def nodal_at(
    view: MembraneView, displacement_m: np.ndarray, field: np.ndarray, pixels: np.ndarray
) -> np.ndarray:
    """Nodal field where the rays of pixels meet the deformed membrane.

    Parameters
    ----------
    view : MembraneView
    displacement_m, field : (n,) array
    pixels : (k,) int array
        Flat indices, ascending.

    Returns
    -------
    (k,) array
        Interpolated linearly; NaN where a ray misses the membrane.
    """
    hits = view.hits(displacement_m, pixels)
    corners = field[view.mesh.triangles[hits.triangle]]
    values = np.full(len(pixels), np.nan)
    values[np.searchsorted(pixels, hits.ray)] = np.sum(hits.barycentric * corners, axis=1)
    return values
