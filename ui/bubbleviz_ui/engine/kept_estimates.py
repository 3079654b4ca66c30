"""Estimates of frames, kept so that another κ needs no solving. No Qt in here."""

from __future__ import annotations

from collections import OrderedDict

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
        self._bytes, self._most = 0, most_bytes

    def get(self, frame: int) -> tuple[Numbers, Estimate] | None:
        """Numbers and estimate of a frame; None where they are not kept."""
        return self._kept.get(frame)

    def keep(self, frame: int, numbers: Numbers, estimate: Estimate) -> None:
        """Keep a frame's in place of what was kept of it, and let go of the oldest."""
        if frame in self._kept:
            self._let_go(frame)
        self._kept[frame] = numbers, estimate
        self._bytes += _size(estimate)
        while self._bytes > self._most:
            self._let_go(next(iter(self._kept)))

    def _let_go(self, frame: int) -> None:
        _, estimate = self._kept.pop(frame)
        self._bytes -= _size(estimate)


def _size(estimate: Estimate) -> int:
    return sum(getattr(value, "nbytes", 0) for value in vars(estimate).values())
