"""Interface of the frame sources."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from bubbleviz.frames.frame import Frame


class FrameSource(Protocol):
    """Frames by index: a recording, or a simulation that makes them when asked.

    Attributes
    ----------
    name : str
        What the window's title shows.
    """

    name: str

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start, s, (F,)."""

    def __len__(self) -> int:
        """Count the frames."""

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1, InputError if it cannot be read."""

    def close(self) -> None:
        """Let go of files."""


def shown_name(source: FrameSource) -> str:
    """What messages call a source: the path of a file, else its name."""
    return str(getattr(source, "path", None) or source.name)
