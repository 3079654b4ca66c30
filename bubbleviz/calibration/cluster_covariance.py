"""Covariance of fitted parameters by the two-way cluster-robust (sandwich) estimator.

A parameter changes by Σ s_p ε_p when range p has the error ε_p; the `influence` s comes from the
linearised fit. Errors may be correlated over the frames of a tile of pixels (fixed pattern of the
camera, shape finer than the fit) and over the tiles of a block of frames (drift of gas or camera).
The variance is that over tiles, plus that over blocks, less that over their intersections (Cameron,
Gelbach and Miller 2011).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import DepthStatistics, mean_inflation, student_factor

_MIN_TILES = 30  # fewer determine their spread poorly
_MIN_BLOCKS = 5  # of frames in the recording, however long the correlation
_BLOCK_INFLATIONS = 2.0  # length of a block of frames in correlation times


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


def cluster_covariances(
    statistics: DepthStatistics,  # of the frames: how far their noise is correlated
    # flat indices (P,) of the pixels or blocks fitted, columns of the image, and side of one in
    # pixels
    layout: tuple[np.ndarray, int, int],
    error_m: np.ndarray,  # (F, P), frames minus their mean, m; NaN: not in it
    influence: np.ndarray,  # (P, Q), derivative of each parameter by each mean, unit/m
    residual_m: np.ndarray,  # (P,), mean minus that of the fitted surface, m
    parameters: int,  # count of fitted parameters
    progress: Progress = quiet,
) -> tuple[np.ndarray, np.ndarray]:
    """The two parts of `covariances`, for parameters fitted to the mean of frames."""
    pixels, columns, side = layout
    length = statistics.correlation_length_px / side
    tile = tile_numbers(pixels, columns, tile_side(len(pixels), length))
    tiles, (count, numbers) = int(tile.max()) + 1, influence.shape
    static, moving = np.zeros((numbers, tiles)), np.zeros((numbers, tiles, len(error_m)))
    kept = np.isfinite(error_m)
    error = np.where(kept, error_m, 0.0).T / np.maximum(kept.sum(axis=0), 1)[:, None]
    for k in range(numbers):
        sums = sparse.csr_array((influence[:, k], (tile, np.arange(count))), shape=(tiles, count))
        static[k], moving[k] = sums @ residual_m, sums @ error
        progress("error of the mean", (k + 1) / numbers)
    block = _BLOCK_INFLATIONS * mean_inflation(statistics.temporal_correlation)
    return covariances(static.T, moving.transpose(2, 1, 0), parameters, max(1, round(block)))


def covariances(
    static: np.ndarray,  # (T, Q), scores of the mean over frames
    moving: np.ndarray,  # (F, T, Q), scores of each frame's difference from the mean
    parameters: int,  # count of fitted parameters
    block: int,  # frames in a block; reduced where there would be fewer than five blocks
) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (Q, Q) over tiles, and over blocks of frames less the noise counted over tiles.

    Their sum is the covariance. Both are widened by Student's quantile over the normal one, as
    there are few clusters.
    """
    frames, tiles, _ = moving.shape
    starts = np.arange(0, frames, max(1, min(block, frames // _MIN_BLOCKS)))
    cells = np.add.reduceat(moving, starts, axis=0)
    by_block = cells.sum(axis=1)
    along = _scatter(by_block)
    noise = np.sum((cells - cells.mean(axis=0)) ** 2, axis=(0, 1))
    variance = np.diag(along)
    beyond = np.sqrt(np.maximum(variance - noise, 0.0) / np.maximum(variance, 1e-300))
    freedom = max(1, tiles - parameters)
    widened = tiles / freedom * student_factor(freedom) ** 2
    over_tiles = widened * _scatter(static + cells.sum(axis=0))
    over_blocks = student_factor(max(1, len(starts) - 1)) ** 2 * along * np.outer(beyond, beyond)
    return over_tiles, over_blocks


def _scatter(scores: np.ndarray) -> np.ndarray:
    """Σ (s − s̄)(s − s̄)ᵀ of scores (k, Q)."""
    centred = scores - scores.mean(axis=0)
    product: np.ndarray = centred.T @ centred
    return product
