"""Estimates of frames, kept so that another κ needs no solving. No Qt in here."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import is_dataclass

import numpy as np

from bubbleviz.diagnostics.frame_numbers import Numbers
from bubbleviz.result import Estimate

MOST_BYTES = 256 * 2**20
"""Some 6,000 frames of 1,000 nodes; chosen."""


class KeptEstimates:
    """The estimates that were computed last, as many as fit.

    Parameters
    ----------
    most_bytes : int, optional
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._kept: OrderedDict[int, tuple[Numbers, Estimate]] = OrderedDict()
        self._sizes: dict[int, int] = {}
        self._most = most_bytes

    def get(self, frame: int) -> tuple[Numbers, Estimate] | None:
        """Numbers and estimate of a frame; None where they are not kept."""
        return self._kept.get(frame)

    def keep(self, frame: int, numbers: Numbers, estimate: Estimate) -> None:
        """Keep a frame's in place of what was kept of it, and let go of the oldest."""
        self._kept.pop(frame, None)
        self._kept[frame] = numbers, estimate
        self._sizes[frame] = _bytes(estimate)
        while sum(self._sizes.values()) > self._most:
            oldest, _ = self._kept.popitem(last=False)
            del self._sizes[oldest]


def _bytes(held: object) -> int:
    """Memory of the arrays in something, and in what that holds."""
    if isinstance(held, np.ndarray):
        return held.nbytes
    return sum(map(_bytes, vars(held).values())) if is_dataclass(held) else 0
