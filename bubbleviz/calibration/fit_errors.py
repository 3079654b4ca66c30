"""Errors of fitted parameters by the residuals of the fit.

A parameter changes by Σ s_p ε_p when range p has the error ε_p; the `influence` s comes from the
linearised fit. Errors are correlated between neighbouring pixels (fixed pattern of the camera,
shape finer than the fit), or differ between parts of the view (a model that does not hold).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.camera import RangeObserver
from bubbleviz.recordings import student_factor

_MIN_TILES = 30  # fewer determine their spread poorly
_RINGS = 4
"""Parts of the view for the jackknife, from rim to top, each larger than the correlation length of
model errors. Differences between left and right are unknowns of the fit."""


def tile_side(pixels: int, correlation_length_px: float) -> int:
    """Side of a tile in pixels: ten correlation lengths, or less to have thirty tiles."""
    largest = int(np.sqrt(pixels / _MIN_TILES))
    return int(
        np.clip(round(10.0 * correlation_length_px), min(4, max(largest, 1)), max(largest, 1))
    )


def tile_numbers(pixels: np.ndarray, width: int, side: int) -> np.ndarray:
    """Number 0 … T−1 of the tile of each flat pixel index (k,); empty tiles have no number."""
    row, column = np.divmod(pixels, width)
    tile = (row // side) * (-(-width // side)) + column // side
    return np.unique(tile, return_inverse=True)[1]


def tile_errors(
    influence: np.ndarray,  # (P, Q), derivative of each parameter by each range
    residual_m: np.ndarray,  # (P,), mean range minus that of the fit, m
    tile: np.ndarray,  # (P,) int, tile of each range
    parameters: int,  # count of fitted parameters
) -> np.ndarray:
    """Errors (T, Q) of a fit by each tile's residuals: a cluster-robust (sandwich) estimate.

    Widened by Student's quantile over the normal one, as there are few tiles.
    """
    sums = np.stack([np.bincount(tile, each * residual_m) for each in influence.T], axis=1)
    count = len(np.unique(tile))
    freedom = max(1, count - parameters)
    widened: np.ndarray = np.sqrt(count / freedom) * student_factor(freedom) * sums
    return widened


def jackknife_errors(
    fit: Callable[[np.ndarray], np.ndarray],  # (Q,) of weights 1 or 0 of the blocks
    part: np.ndarray,  # of each block, int from 0
) -> np.ndarray:
    """Errors (K, Q) of a fit by model errors that differ between K parts of the view.

    By fits without each part, widened as there are few parts.
    """
    count = int(part.max()) + 1
    found = np.stack([fit((part != k).astype(float)) for k in range(count)])
    widened: np.ndarray = np.sqrt((count - 1) / count) * student_factor(count - 1) * found
    return widened - widened.mean(axis=0)


def height_rings(observer: RangeObserver) -> np.ndarray:
    """Ring of each block, (B,) int, of equal numbers of blocks from rim to top."""
    mesh = observer.mesh
    hits = observer.around(mesh.nodes).hits
    height = np.full(observer.blocks, -np.inf)
    height[hits.ray] = hits.values(mesh.nodes[:, 2], mesh.triangles)
    return np.searchsorted(np.quantile(height, np.arange(1, _RINGS) / _RINGS), height)
