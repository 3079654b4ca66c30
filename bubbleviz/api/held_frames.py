"""Frames in memory as a source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bubbleviz.frames.frame import Frame


class HeldFrames:
    """A source of frames that are in memory.

    Parameters
    ----------
    frames : sequence of Frame

    Attributes
    ----------
    name : str
    """

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._frames = frames
        self.name = f"frame {frames[0].index}" if len(frames) == 1 else f"{len(frames)} frames"

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame, s, (F,)."""
        return np.array([frame.time_s for frame in self._frames])

    def __len__(self) -> int:
        """Count the frames."""
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index` of them."""
        return self._frames[index]

    def close(self) -> None:
        """Nothing to let go of."""
