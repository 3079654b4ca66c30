"""Frames of a source, chosen as from a list."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Self, overload

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.recording import Recording
from bubbleviz.wording import count_of


class Frames(Sequence[Frame]):
    """Frames of a recording or a simulation, like a list: `frames[3]`, `frames[-1]`, `frames[::2]`.

    A frame is read when it is asked for, and not kept. Slices share the open file.

    Parameters
    ----------
    source : FrameSource
    chosen : range, optional
        Indices of the frames in the source; all by default.

    Attributes
    ----------
    source : FrameSource
    chosen : range
    name : str
        Of the source.
    path : Path or None
        Of the source, where it is a file.
    """

    def __init__(self, source: FrameSource, chosen: range | None = None) -> None:
        self.source = source
        self.chosen = range(len(source)) if chosen is None else chosen
        self.name = source.name
        self.path: Path | None = getattr(source, "path", None)

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.chosen)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Self: ...
    def __getitem__(self, index: int | slice) -> Frame | Self:
        """One frame, or some of them.

        Raises
        ------
        IndexError
            There is no such frame.
        InputError
            It cannot be read.
        """
        if isinstance(index, slice):
            return type(self)(self.source, self.chosen[index])
        try:
            chosen = self.chosen[index]
        except IndexError:
            raise IndexError(f"frame {index} of {len(self)} of {self.name}") from None
        return self.source[chosen]

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start of the source, s, (F,)."""
        return self.source.times_s[self.chosen]

    def close(self) -> None:
        """Let go of the file, which all slices share."""
        self.source.close()

    def __enter__(self) -> Frames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{count_of(len(self), 'frame')} of {self.name}>"


def open(
    path: str | Path,
    *,
    depth_topic: str | None = None,
    info_topic: str | None = None,
    pressure_topic: str | None = None,
    wrench_topic: str | None = None,
) -> Frames:
    """Open a recording.

    Parameters
    ----------
    path : path
        rosbag2 (folder, `.mcap`, `.db3`) or ROS 1 `.bag` with a depth image (`16UC1` in mm, `32FC1`
        in m) or a point cloud and, where there are, camera info, gas pressure and wrench.
    depth_topic, info_topic, pressure_topic, wrench_topic : str, optional
        Topics to use; without them the first depth images, and of the others the nearest by name.

    Returns
    -------
    Frames
        With `depth_m` (H, W) in m, `gas_pressure_pa` (absolute), `wrench` (6,) in N and N·m.

    Raises
    ------
    InputError
        The file is missing, damaged or truncated, or has no depth images.

    Examples
    --------
    >>> press = bv.open("press.mcap")
    >>> press[-1].depth_m.shape
    (171, 224)
    """
    recording = Recording(
        path,
        depth_topic=depth_topic,
        info_topic=info_topic,
        pressure_topic=pressure_topic,
        wrench_topic=wrench_topic,
    )
    return Frames(recording)
