"""Assembly of a mesh's sparse matrices from blocks of its triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FIRST, SECOND = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
"""Corners of the six pairs that a symmetric matrix has blocks of."""
_SAME = [0, 3, 5]  # pairs of a corner with itself


class Assembly(NamedTuple):
    """Positions of the triangles' entries in a symmetric sparse matrix, three rows a node."""

    # indices, indptr: int arrays, of the columns
    indices: np.ndarray
    indptr: np.ndarray
    # (6 · 9 · m,) int, place in the data of every entry of the blocks (pair of corners, 3, 3, m)
    slots: np.ndarray
    mirror: np.ndarray  # int, place of the transposed entry

    @classmethod
    def of(cls, corners: np.ndarray, moving: np.ndarray, nodes: int) -> Assembly:
        """Pattern over the `moving` nodes of all `nodes`, for triangles (3, m)."""
        size = 3 * len(moving)
        dof = np.full((nodes, 3), -1)
        dof[moving] = np.arange(size).reshape(-1, 3)
        corner = dof[corners].transpose(0, 2, 1)  # (corner, component, m)
        row, column = np.broadcast_arrays(corner[FIRST][:, :, None], corner[SECOND][:, None])
        row, column = row.ravel(), column.ravel()
        kept = (row >= 0) & (column >= 0)
        there, back = column[kept] * size + row[kept], row[kept] * size + column[kept]
        keys, where = np.unique(np.concatenate([there, back]), return_inverse=True)
        slots = np.full(len(row), len(keys))  # fixed nodes: one extra entry
        slots[kept] = where[: len(there)]
        columns, rows = np.divmod(keys, size)
        indptr = np.searchsorted(columns, np.arange(size + 1))
        mirror = np.searchsorted(keys, rows * size + columns)
        return cls(rows.astype(np.int32), indptr.astype(np.int32), slots, mirror)

    def assembled(self, blocks: np.ndarray) -> np.ndarray:
        """Data of the matrix that blocks (6, 3, 3, m) and their transposes add up to."""
        blocks[_SAME] *= 0.5  # they and their transposes are both on the diagonal
        half = np.bincount(self.slots, blocks.ravel(), minlength=len(self.indices) + 1)[:-1]
        return half + half[self.mirror]
