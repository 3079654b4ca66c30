"""Places of an object that may touch: spread over its faces, denser along its edges."""

from __future__ import annotations

import numpy as np

from bubbleviz.pose.object_model import ObjectModel

_TRIES = 30
_MOST = 200_000


def contact_samples(model: ObjectModel, spacing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) in O about `spacing_m` apart, half that along creases, and normals (k, 2, 3).

    Along a crease the two normals are those of its faces, elsewhere they are the same.
    """
    count = min(_MOST, int(_TRIES * model.area_m2 / spacing_m**2) + _TRIES)
    points, single = model.sample(count)
    normals = np.repeat(single[:, None], 2, axis=1)
    if model.creases is None:
        kept = _thinned(points, spacing_m)
        return points[kept], normals[kept]
    edge = np.asarray(model.creases.tree.data)
    distance, _ = model.creases.tree.query(points)
    clear = distance > 0.5 * spacing_m
    points, normals = points[clear], normals[clear]
    kept, along = _thinned(points, spacing_m), _thinned(edge, 0.5 * spacing_m)
    return (
        np.concatenate([edge[along], points[kept]]),
        np.concatenate([model.creases.normals[along], normals[kept]]),
    )


def _thinned(points: np.ndarray, spacing_m: float) -> np.ndarray:
    """Indices of one point for each cube of a grid, the one closest to its centre."""
    cube = np.floor(points / spacing_m)
    off = np.sum((points / spacing_m - cube - 0.5) ** 2, axis=1)
    order = np.lexsort((off, *cube.T))
    new = np.any(np.diff(cube[order], axis=0) != 0.0, axis=1)
    return order[np.concatenate([np.ones(min(1, len(order)), bool), new])]
