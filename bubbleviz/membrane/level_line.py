"""The line on a triangle mesh where a nodal field has a level."""

from __future__ import annotations

import numpy as np


def level_line(
    points: np.ndarray,  # (n, 3)
    corners: np.ndarray,  # (3, m) int, triangles by corner
    field: np.ndarray,  # (n,), linear on each triangle
    level: float = 0.0,
) -> np.ndarray:
    """Straight pieces of the line, one in each triangle that it crosses, (k, 2, 3)."""
    above = field - level
    inside = (above > 0.0).take(corners)
    count = inside.sum(axis=0)
    cut = np.flatnonzero((count == 1) | (count == 2))
    # Turn each cut triangle so that its first corner is the one alone on its side.
    alone = np.argmax(inside[:, cut] == (count[cut] == 1), axis=0)
    a, b, c = (corners[(alone + k) % 3, cut] for k in range(3))
    start, height = points.take(a, axis=0), above[a]
    pieces = np.empty((len(cut), 2, 3))
    for end, k in enumerate((b, c)):
        share = height / (height - above[k])
        pieces[:, end] = start + share[:, None] * (points.take(k, axis=0) - start)
    return pieces
