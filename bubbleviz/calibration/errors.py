"""Covariance of fitted numbers by clusters of pixels and of frames (the cluster sandwich).

A fitted number changes by Σ s_p ε_p when range p is off by ε_p: `influence` s, from the fit's own
linearisation. Errors may be shared along the frames of a tile of pixels (fixed pattern of the
camera, shape finer than the fit) and across the tiles of a block of frames (drift of gas or
camera). The variance of both clusterings is that over tiles, plus that over blocks, less that over
the cells, which both contain (Cameron, Gelbach and Miller 2011).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.special import ndtri, stdtrit

from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import DepthStatistics, mean_inflation

_MIN_TILES = 30  # of the image at least: fewer say little about their spread
_LEAST_BLOCKS = 5  # of frames in the recording, however long the correlation
_BLOCK_INFLATIONS = 2.0  # correlation times to a block of frames


def tile_side(pixels: int, correlation_length_px: float) -> int:
    """Side of a tile in pixels: ten correlation lengths, while it leaves thirty tiles."""
    largest = int(np.sqrt(pixels / _MIN_TILES))
    return int(
        np.clip(round(10.0 * correlation_length_px), min(4, max(largest, 1)), max(largest, 1))
    )


def tile_numbers(pixels: np.ndarray, width: int, side: int) -> np.ndarray:
    """Number 0 … T−1 of the tile of each flat pixel index (k,); only tiles with pixels count."""
    row, column = np.divmod(pixels, width)
    tile = (row // side) * (-(-width // side)) + column // side
    return np.unique(tile, return_inverse=True)[1]


def cluster_covariances(
    statistics: DepthStatistics,  # of the frames: how far their noise is correlated
    # flat indices (P,) of the pixels or blocks that took part, columns of the image, and pixels
    # along the side of one
    place: tuple[np.ndarray, int, int],
    # frames (F, P), mean_m and limit_m (P,), influence (P, Q), residual_m (P,): as of `tile_scores`
    frames: np.ndarray,
    mean_m: np.ndarray,
    limit_m: np.ndarray,
    influence: np.ndarray,
    residual_m: np.ndarray,
    parameters: int,  # numbers fitted to the tiles
    progress: Progress = quiet,
) -> tuple[np.ndarray, np.ndarray]:
    """Covariances, as of `covariances`, of numbers fitted to the mean of frames."""
    numbers, columns, side = place
    tile = tile_numbers(
        numbers, columns, tile_side(len(numbers), statistics.correlation_length_px / side)
    )
    scores = tile_scores(frames, mean_m, limit_m, influence, residual_m, tile, progress)
    block = _BLOCK_INFLATIONS * mean_inflation(statistics.temporal_correlation)
    return covariances(*scores, parameters, max(1, round(block)))


def tile_scores(
    depth_m: np.ndarray,  # (F, P), z-depth of the pixels that took part, m; NaN: no return
    # mean_depth_m, limit_m: (P,), their mean, and how far a sample may be from it to count (as in
    # the mean), m
    mean_depth_m: np.ndarray,
    limit_m: np.ndarray,
    # (P, Q), change of each number per change of each pixel's mean z-depth, unit/m
    influence: np.ndarray,
    residual_m: np.ndarray,  # (P,), mean z-depth minus that of the fitted surface, m
    tile: np.ndarray,  # (P,) int
    progress: Progress = quiet,
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over tiles of influence times error: of the mean (T, Q), of every frame (F, T, Q)."""
    tiles, (count, numbers) = int(tile.max()) + 1, influence.shape
    rows = (tile[None] + tiles * np.arange(numbers)[:, None]).ravel()
    columns = np.tile(np.arange(count), numbers)
    sums = sparse.csr_array((influence.T.ravel(), (rows, columns)), shape=(numbers * tiles, count))
    static = (sums @ residual_m).reshape(numbers, tiles).T
    kept = np.zeros(count)
    for image in depth_m:
        kept += np.abs(image - mean_depth_m) <= limit_m
    share = 1.0 / np.maximum(kept, 1.0)
    moving = np.empty((len(depth_m), tiles, numbers))
    for k, image in enumerate(depth_m):
        error = image - mean_depth_m
        error = np.where(np.abs(error) <= limit_m, error, 0.0) * share
        moving[k] = (sums @ error).reshape(numbers, tiles).T
        progress("error of the mean", (k + 1) / len(depth_m))
    return static, moving


def covariances(
    static: np.ndarray,  # (T, Q), scores of the tiles' mean
    moving: np.ndarray,  # (F, T, Q), scores of what each frame differs from the mean by
    parameters: int,  # numbers fitted to the tiles
    block: int,  # frames that belong together; fewer where less than five blocks would be left
) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (Q, Q) by tiles, and by blocks of frames beyond the noise that tiles hold.

    They add up. Wider by Student's quantile over the normal one, as there are few clusters.
    """
    frames, tiles, _ = moving.shape
    starts = np.arange(0, frames, max(1, min(block, frames // _LEAST_BLOCKS)))
    cells = np.add.reduceat(moving, starts, axis=0)
    by_block = cells.sum(axis=1)
    along = _outer(by_block)
    noise = np.sum((cells - cells.mean(axis=0)) ** 2, axis=(0, 1))
    variance = np.diag(along)
    beyond = np.sqrt(np.maximum(variance - noise, 0.0) / np.maximum(variance, 1e-300))
    freedom = max(1, tiles - parameters)
    widened = tiles / freedom * student(freedom) ** 2
    of_tiles = widened * _outer(static + cells.sum(axis=0))
    of_blocks = student(max(1, len(starts) - 1)) ** 2 * along * np.outer(beyond, beyond)
    return of_tiles, of_blocks


def _outer(scores: np.ndarray) -> np.ndarray:
    """Σ (s − s̄)(s − s̄)ᵀ of scores (k, Q)."""
    centred = scores - scores.mean(axis=0)
    product: np.ndarray = centred.T @ centred
    return product


def student(freedom: int) -> float:
    """How much wider Student's 95 % interval is than the normal one."""
    return float(stdtrit(freedom, 0.975) / ndtri(0.975))
