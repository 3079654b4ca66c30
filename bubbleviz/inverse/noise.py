"""Noise factors: the residual of a frame over the noise of the camera, by which it is weighted."""

from __future__ import annotations

from math import log
from typing import NamedTuple

from bubbleviz.camera import UPPER_95

_RATIO, _MAX_NOISES = 1.1, 8
"""Ratio of successive noise factors on the grid that frames are solved with, and how many are tried
in a frame. Without a grid, the result would depend on the first one. Half a step is about a
standard deviation: an image with correlated noise counts as some 650 samples, which determine the
factor to 5 %. Factors below 1 are less certain, and their ratio is `UPPER_95`."""
_FLOW_RATIO = 1.3
"""The same for optical flow: its two components in some forty squares determine its noise factor to
14 %."""


class Noise(NamedTuple):
    """Noise factors: σ of the residual over that of the noise; `flow` is 0 until it is known."""

    ranges: float
    flow: float = 0.0

    def with_ranges(self, factor: float) -> Noise:
        """The same with the nearest factor of the ranges on the grid."""
        return self._replace(ranges=_on_grid(factor, _RATIO))

    def with_flow(self, factor: float) -> Noise:
        """The same with the nearest factor of the optical flow on the grid."""
        return self._replace(flow=_on_grid(factor, _FLOW_RATIO))


AS_EXPECTED = Noise(1.0)


def noise_converged(updated: Noise, noise: Noise, earlier: list[Noise]) -> bool:
    """Whether the noise factors with which a frame was solved have converged."""
    by_kind = zip(updated, noise, zip(*earlier, strict=True) if earlier else ((), ()), strict=True)
    # Two factors can alternate forever, each with its own support: the larger one is taken.
    same = (now == before or (now < before and now in others) for now, before, others in by_kind)
    return len(earlier) + 1 >= _MAX_NOISES or all(same)


def are_neighbours(one: Noise, other: Noise) -> bool:
    """Whether two noise factors of ranges are at most a step of the grid apart."""
    factors = one.ranges, other.ranges
    if min(factors) < 1.0:
        return factors[0] == factors[1]
    return abs(_grid_index(factors[0] / factors[1], _RATIO)) <= 1


def _grid_index(noise: float, ratio: float) -> int:
    """Nearest power of a ratio to a noise factor."""
    return round(log(noise) / log(ratio))


def _on_grid(noise: float, ratio: float) -> float:
    """Nearest noise factor on the grid."""
    step = ratio if noise >= 1.0 else UPPER_95
    return float(step ** _grid_index(noise, step))
