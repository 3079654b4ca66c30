"""Squares of blocks over the image, in which correlated noise and the model's error show."""

from __future__ import annotations

import numpy as np

_SQUARES = 40
"""Number of squares, the same for every mesh: what the model gets wrong is alike over much of one,
and their median needs some tens."""

SURELY = 1.6
"""Upper limit of a median over `_SQUARES` squares, which is known to a fifth, at two standard
deviations."""

MAD = 0.6745  # median of |z| of a standard normal z


class BlockSquares:
    """Squares that some blocks lie in.

    Attributes
    ----------
    of_block : (B,) int array
        Number of the square of each.
    """

    def __init__(
        self,
        blocks: np.ndarray,  # (B,) int, numbers of the blocks, row by row over the image
        columns: int,  # blocks in a row of the image
    ) -> None:
        self._side = max(1, round(np.sqrt(len(blocks) / _SQUARES)))
        row, column = np.divmod(blocks, columns)
        self.of_block = (row // self._side) * columns + column // self._side

    def noise_left(
        self,
        block: np.ndarray,  # (k,) int, positions in `blocks`
        z: np.ndarray,  # (k,), errors in standard deviations; 0 where nothing was measured
    ) -> float:
        """Size of errors over that of their noise; 1 where too few are seen to tell.

        By the median of their sums over squares, which white noise has at random. What the model
        gets wrong is alike from block to block, and so is correlated noise.
        """
        square = self.of_block[block]
        sums, count = np.bincount(square, z), np.bincount(square, z != 0.0)
        full = count >= 0.5 * self._side**2
        if not full.any():
            return 1.0
        return float(median(np.abs(sums[full]) / np.sqrt(count[full])) / MAD)


def median(values: np.ndarray) -> np.ndarray:
    """Median along the last axis of values (…, k), k > 0; a third of the time of NumPy's own.

    NaN are not looked for.
    """
    count = values.shape[-1]
    low, high = (count - 1) // 2, count // 2
    ordered = np.partition(values, high if low == high else (low, high), axis=-1)
    middle: np.ndarray = 0.5 * (ordered[..., low] + ordered[..., high])
    return middle
