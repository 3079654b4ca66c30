"""Whether two depth images differ by more than their noise."""

from __future__ import annotations

import numpy as np
from scipy import special

from bubbleviz.camera.observer import MAD, Measured, RangeObserver, median

_LEVEL = 0.002
"""Significance level of each test. With some five tests per pair, an image of a membrane at rest
agrees with ten others in nine of ten cases."""

_FEWEST_CELLS = 100  # in the finest grid: the scale of the noise is then known to some 15 %

_MEDIAN_EFFICIENCY = 0.37  # of a median of squares of Gaussian noise, against their mean


class ImageChange:
    """Compares images of one camera over grids of cells, from fine to coarse.

    A motion too small to be detected in single blocks of pixels is detected in cells as large as
    what moves. A press that becomes deeper is also detected by the projection of the change on the
    deformation. The noise is estimated from the median over the cells of the finest grid, since it
    may be correlated between pixels and differ from the sensor file's. Noise that is correlated
    between cells looks like a change.
    """

    def __init__(self, observer: RangeObserver) -> None:
        row, column = np.divmod(observer.block_number, observer.columns)
        side = max(1, int(np.sqrt(observer.blocks / _FEWEST_CELLS)))
        row, column = row // side, column // side
        # number of the cell of each block in the finest grid; then of the cell of each cell
        self._cells: list[np.ndarray] = []
        while not self._cells or len(row) > 1:
            _, first, cells = np.unique(
                row * observer.columns + column, return_index=True, return_inverse=True
            )
            self._cells.append(cells)
            row, column = row[first] // 2, column[first] // 2

    def differ(self, one: Measured, other: Measured) -> bool:
        """Whether the images differ by more than noise, anywhere."""
        both = one.total + other.total
        weight = np.divide(one.total * other.total, both, out=np.zeros_like(both), where=both > 0.0)
        first, second = _mean(one), _mean(other)
        change = second - first
        squares = self._squares(weight, change)
        if not len(squares[0]):
            return True  # they have no pixel in common
        variance = float(median(squares[0])) / MAD**2
        if not variance:
            return bool(change.any())
        known = _MEDIAN_EFFICIENCY * len(squares[0])
        deformed = 0.5 * (first + second)  # since the reference configuration
        if strength := float(weight @ deformed**2):
            squares.append(np.array([(weight @ (deformed * change)) ** 2 / strength]))
        return any(
            special.fdtrc(len(each), known, each.mean() / variance) < _LEVEL for each in squares
        )

    def _squares(self, weight: np.ndarray, change: np.ndarray) -> list[np.ndarray]:
        """Squares of the mean changes of the cells of each grid, in squares of their σ."""
        found, moment = list[np.ndarray](), weight * change
        for cells in self._cells:
            weight, moment = np.bincount(cells, weight), np.bincount(cells, moment)
            seen = weight > 0.0
            found.append(moment[seen] ** 2 / weight[seen])
        return found


def _mean(measured: Measured) -> np.ndarray:
    """Mean residuals (B,) of the blocks, m; 0 where no pixel is valid."""
    total, moment = measured.total, measured.moment
    return np.divide(moment, total, out=np.zeros_like(total), where=total > 0.0)
