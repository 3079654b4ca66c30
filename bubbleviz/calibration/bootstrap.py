"""Block bootstrap over frames and pixels of numbers that depend on a mean range image.

A fitted number changes by Σ s_p ε_p when range p is off by ε_p: `influence` s, from the fit's
own linearisation. What enters the bootstrap is that sum over the pixels of a tile, for every
frame (what changed in time) and once for the mean (what the surface leaves unexplained: the
fixed pattern of the camera, or shape). Resampling these few numbers is a score bootstrap (Kline
and Santos 2012): no image is touched and nothing is fitted again.

Errors may be shared along the frames of a tile (fixed pattern) and across the tiles of a block
of frames (drift of the gas, of the camera). The variance of both clusterings is that over tiles,
plus that over blocks, less that over the cells, which both contain (Cameron, Gelbach and Miller
2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.special import ndtri, stdtrit

from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import DepthStatistics, mean_inflation

if TYPE_CHECKING:
    from bubbleviz.calibration.rest_frames import Samples

DRAWS = 4_000  # the 2.5 % quantile then rests on 100 of them
_MIN_TILES = 30  # of the image at least: fewer say little about their spread
_LEAST_BLOCKS = 5  # of frames in the recording, however long the correlation
_BLOCK_INFLATIONS = 2.0  # correlation times to a block of frames
_CLIP = 3.0  # as the mean of a pixel is clipped


@dataclass(frozen=True)
class ScoreTable:
    """Contribution of each tile and frame to the error of Q numbers."""

    # (T, Q), of what the mean range of each tile's pixels differs from the fitted surface by
    static: np.ndarray
    moving: np.ndarray  # (F, T, Q), of what each frame differs from the mean by
    parameters: int  # numbers fitted to the tiles


@dataclass(frozen=True)
class Draws:
    """Bootstrap errors of Q numbers."""

    # tiles, frames: (R, Q), errors when tiles, or blocks of frames beyond their noise, are drawn
    # again
    tiles: np.ndarray
    frames: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """Both together, (R, Q)."""
        return self.tiles + self.frames


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


def score_table(
    depth_m: np.ndarray,  # (F, P), z-depth of the pixels that took part, m; NaN: no return
    # mean_depth_m, limit_m: (P,), their mean, and how far a sample may be from it to count (as in
    # the mean), m
    mean_depth_m: np.ndarray,
    limit_m: np.ndarray,
    # (P, Q), change of each number per change of each pixel's mean z-depth, unit/m
    influence: np.ndarray,
    residual_m: np.ndarray,  # (P,), mean z-depth minus that of the fitted surface, m
    tile: np.ndarray,  # (P,) int
    parameters: int,  # numbers fitted to the tiles
    progress: Progress = quiet,
) -> ScoreTable:
    """Sums over tiles of influence times error, for every frame and for the mean."""
    tiles, numbers = int(tile.max()) + 1, influence.shape[1]
    sums = _tile_sums(influence, tile, tiles)
    static = (sums @ residual_m).reshape(numbers, tiles).T
    kept = np.zeros(len(tile))
    for image in depth_m:
        kept += np.abs(image - mean_depth_m) <= limit_m
    share = 1.0 / np.maximum(kept, 1.0)
    moving = np.empty((len(depth_m), tiles, numbers))
    for k, image in enumerate(depth_m):
        error = image - mean_depth_m
        error = np.where(np.abs(error) <= limit_m, error, 0.0) * share
        moving[k] = (sums @ error).reshape(numbers, tiles).T
        progress("bootstrap", (k + 1) / len(depth_m))
    return ScoreTable(static, moving, parameters)


def samples_scores(
    samples: Samples,
    pixels: np.ndarray,  # (P,) int, flat indices of those that took part
    # (P, Q), change of each number per change of each pixel's mean range, unit/m
    influence: np.ndarray,
    residual_m: np.ndarray,  # (P,), mean range minus that of the fitted surface, m
    parameters: int,  # numbers fitted to the tiles
    progress: Progress = quiet,
) -> ScoreTable:
    """Score table of samples."""
    statistics = samples.statistics
    to_depth = samples.camera.range_per_depth.ravel()[pixels].astype(float)
    noise = np.maximum(statistics.noise_m.ravel()[pixels], statistics.quantum_m)
    side = tile_side(len(pixels), statistics.correlation_length_px)
    return score_table(
        samples.depth_m.reshape(len(samples.depth_m), -1)[:, pixels],
        np.nan_to_num(statistics.range_m.ravel()[pixels] / to_depth),
        np.nan_to_num(_CLIP * noise / to_depth),
        influence * to_depth[:, None],
        residual_m / to_depth,
        tile_numbers(pixels, samples.camera.intrinsics.width, side),
        parameters,
        progress,
    )


def frames_block(statistics: DepthStatistics) -> int:
    """Frames to a block of `draw_errors`, by how long the noise of a pixel is correlated."""
    return max(1, round(_BLOCK_INFLATIONS * mean_inflation(statistics.temporal_correlation)))


def _tile_sums(influence: np.ndarray, tile: np.ndarray, tiles: int) -> sparse.csr_array:
    """(Q·T, P): sums each number's influence over each tile."""
    count, numbers = influence.shape
    rows = (tile[None] + tiles * np.arange(numbers)[:, None]).ravel()
    columns = np.tile(np.arange(count), numbers)
    return sparse.csr_array((influence.T.ravel(), (rows, columns)), shape=(numbers * tiles, count))


def draw_errors(table: ScoreTable, block: int, seed: int = 0, draws: int = DRAWS) -> Draws:
    """Draw tiles, and blocks of so many frames, with replacement.

    Parameters
    ----------
    table : ScoreTable
    block : int
        Frames that are drawn together; shortened where fewer than five blocks would be left.
    """
    rng = np.random.default_rng(seed)
    frames, tiles, _ = table.moving.shape
    starts = np.arange(0, frames, max(1, min(block, frames // _LEAST_BLOCKS)))
    cells = np.add.reduceat(table.moving, starts, axis=0)
    by_tile = table.static + cells.sum(axis=0)
    by_block = cells.sum(axis=1)
    along_frames = _resampled(by_block, rng, draws)
    # The noise of a cell is in the tiles' draws already.
    variance = np.sum((by_block - by_block.mean(axis=0)) ** 2, axis=0)
    noise = np.sum((cells - cells.mean(axis=0)) ** 2, axis=(0, 1))
    beyond = np.sqrt(np.maximum(variance - noise, 0.0) / np.maximum(variance, 1e-300))
    freedom = max(1, tiles - table.parameters)
    return Draws(
        tiles=_resampled(by_tile, rng, draws) * np.sqrt(tiles / freedom) * _student(freedom),
        frames=along_frames * beyond * _student(max(1, len(starts) - 1)),
    )


def _resampled(scores: np.ndarray, rng: np.random.Generator, draws: int) -> np.ndarray:
    """Sums of as many scores (k, Q) drawn with replacement, about their expectation; (R, Q)."""
    count = len(scores)
    times = rng.multinomial(count, np.full(count, 1.0 / count), size=draws) - 1.0
    return times @ scores


def _student(freedom: int) -> float:
    """How much wider Student's 95 % interval is than the normal one."""
    return float(stdtrit(freedom, 0.975) / ndtri(0.975))
