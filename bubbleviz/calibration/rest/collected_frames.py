"""Frames collected from a live source, as a frame source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame


class CollectedFrames:
    """Frames kept in memory, in the order in which they came.

    Parameters
    ----------
    name : str
        Of the live source.
    frames : sequence of Frame

    Raises
    ------
    InputError
        There are none.
    """

    def __init__(self, name: str, frames: Sequence[Frame]) -> None:
        if not frames:
            raise InputError(f"{name}: no frame was collected; wait for the source")
        self.name = name
        self._frames = tuple(frames)
        self.times_s = np.array([frame.time_s for frame in frames])

    def __len__(self) -> int:
        """Count the frames."""
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return self._frames[index]

    def close(self) -> None:
        """Nothing to let go of."""
