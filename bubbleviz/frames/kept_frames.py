"""A source that is gone over several times, read once."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource

KEPT_BYTES = 512 << 20
"""Depth images kept: 436 of 640×480 pixels."""


class KeptFrames:
    """Keeps the frames of a source as they are read, until memory is used up.

    The first frames are kept, as several steps of a calibration look at those without contact;
    frames beyond are read again.

    Parameters
    ----------
    source : FrameSource
        Not closed with this.
    limit_bytes : int
        Of depth images.

    Attributes
    ----------
    name : str
    path : Path or None
        Of the source, where it is a file.
    """

    def __init__(self, source: FrameSource, limit_bytes: int = KEPT_BYTES) -> None:
        self._source, self._limit, self._left = source, limit_bytes, limit_bytes
        self._frames: dict[int, Frame] = {}
        self.name = source.name
        self.path: Path | None = getattr(source, "path", None)

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start, s, (F,)."""
        return self._source.times_s

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; errors as of the source."""
        if index in self._frames:
            return self._frames[index]
        frame = self._source[index]
        if frame.depth_m.nbytes <= self._left:
            self._left -= frame.depth_m.nbytes
            self._frames[index] = frame
        return frame

    def close(self) -> None:
        """Forget the frames."""
        self._frames.clear()
        self._left = self._limit
