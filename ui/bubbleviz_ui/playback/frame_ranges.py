"""Ranges of frames, as selected on the timeline."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bubbleviz.calibration import Ranges


def tidy(ranges: Iterable[tuple[int, int]], frames: int) -> Ranges:
    """Ranges clipped to 0 … frames, sorted, overlapping and adjacent ones merged."""
    joined: list[tuple[int, int]] = []
    for start, stop in sorted((max(a, 0), min(b, frames)) for a, b in ranges):
        if start >= stop:
            continue
        if joined and start <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], stop))
        else:
            joined.append((start, stop))
    return tuple(joined)


def without(ranges: Ranges, start: int, stop: int) -> Ranges:
    """Ranges without the frames start … stop − 1."""
    parts = [part for a, b in ranges for part in ((a, min(b, start)), (max(a, stop), b))]
    return tidy([(a, b) for a, b in parts if a < b], max((b for _, b in ranges), default=0))


def in_words(ranges: Ranges) -> str:
    """Ranges as text such as "0–59, 80–99", last frames included."""
    return ", ".join(f"{a}–{b - 1}" if b - a > 1 else f"{a}" for a, b in ranges) or "none"
