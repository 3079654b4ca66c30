"""Pixels that see the membrane: the largest part of the cloud without steps in depth."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.recordings import robust_sigma

_STEP_SIGMA = 6.0  # standard deviations beyond which differences of neighbours are steps


def membrane_pixels(
    distance_m: np.ndarray,  # (H, W), distance of each pixel's point from the fitted cap, m
    known: np.ndarray,  # (H, W) bool, pixels with returns in enough frames
) -> np.ndarray:
    """Pixels of the largest connected part of the measured surface, (H, W) bool.

    A step in the distance from the fitted cap separates neighbours, as at the edges of false
    returns and of the housing behind the rim.
    """
    index = np.arange(known.size).reshape(known.shape)
    pairs = []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:, :], np.s_[:-1, :])):
        both = known[a] & known[b]
        step = np.abs(distance_m[a] - distance_m[b])[both]
        pairs.append((index[a][both], index[b][both], step))
    first, second, steps = (np.concatenate(part) for part in zip(*pairs, strict=True))
    together = steps <= _STEP_SIGMA * max(robust_sigma(steps, center=0.0), 1e-9)
    graph = sparse.coo_array(
        (np.ones(int(together.sum()), bool), (first[together], second[together])),
        shape=(known.size, known.size),
    )
    labels = connected_components(graph, directed=False)[1]
    sizes = np.bincount(labels[known.ravel()])
    return (labels == np.argmax(sizes)).reshape(known.shape) & known


def away_from_edges(region: np.ndarray, distance_px: float) -> np.ndarray:
    """Pixels of a region (H, W) further than a distance from its edges.

    The image's border does not count as an edge: the surface continues beyond it.
    """
    inside = ndimage.distance_transform_edt(np.pad(region, 1, mode="edge"))[1:-1, 1:-1]
    return region & (inside > distance_px)


def outer_edge(region: np.ndarray) -> np.ndarray:
    """Pixels (H, W) on the outer edge of a region, without edges of holes and image border."""
    filled = ndimage.binary_fill_holes(region)
    return region & filled & ~ndimage.binary_erosion(filled, border_value=1)


# Height of the rim from the edge of the measured membrane.


def rim_height(
    edge_heights_m: np.ndarray,  # (k,), heights of the edge's points along the dome's axis, m
) -> tuple[float, float]:
    """Height of the rim and its uncertainty, m, from heights of the cloud's outer edge.

    Some points of the edge lie on the rim, all at one height; others, where depth ends early, at
    any height above it. So the rim is the mode of the heights (repeated selection of the densest
    half). The uncertainty is half the width of the densest quarter.
    """
    heights = np.sort(edge_heights_m[np.isfinite(edge_heights_m)])
    if not len(heights):
        return float("nan"), float("nan")
    spread = 0.5 * float(np.ptp(_densest(heights, max(2, len(heights) // 4))))
    while len(heights) > 3:
        heights = _densest(heights, (len(heights) + 1) // 2)
    return float(heights.mean()), spread


def _densest(ordered: np.ndarray, count: int) -> np.ndarray:
    """The `count` consecutive values of a sorted array with the smallest range."""
    count = min(count, len(ordered))
    spans = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    start = int(np.argmin(spans))
    return ordered[start : start + count]
