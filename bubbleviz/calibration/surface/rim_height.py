"""Where the rim is: from the edge of the measured membrane."""

from __future__ import annotations

import numpy as np


def rim_height(edge_heights_m: np.ndarray) -> tuple[float, float]:
    """Height of the rim and its uncertainty, m, from heights of the cloud's outer edge.

    The edge of the cloud is the rim, or only the edge of what the camera could match. The
    latter lies anywhere above the rim, the former at one height: the mode of the heights, found
    by halving to the densest half again and again. The uncertainty is half the width of the
    densest quarter.

    Parameters
    ----------
    edge_heights_m : (k,) array
        Heights of the edge's points along the dome's axis, m.
    """
    heights = np.sort(edge_heights_m[np.isfinite(edge_heights_m)])
    if not len(heights):
        return float("nan"), float("nan")
    spread = 0.5 * float(np.ptp(_densest(heights, max(2, len(heights) // 4))))
    while len(heights) > 3:
        heights = _densest(heights, (len(heights) + 1) // 2)
    return float(heights.mean()), spread


def _densest(ordered: np.ndarray, count: int) -> np.ndarray:
    """The `count` consecutive values of a sorted array that span least."""
    count = min(count, len(ordered))
    spans = ordered[count - 1 :] - ordered[: len(ordered) - count + 1]
    start = int(np.argmin(spans))
    return ordered[start : start + count]
