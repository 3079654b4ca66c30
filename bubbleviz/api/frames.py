"""Frames of a source as a sequence, and facts about a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self, overload

import numpy as np

from bubbleviz.api.summary import Summary
from bubbleviz.camera import Intrinsics
from bubbleviz.errors import InputError, check_type
from bubbleviz.recordings import (
    Frame,
    FrameSource,
    Gap,
    Recording,
    Topic,
    find_gaps,
    open_recording,
    usual_step,
)
from bubbleviz.wording import count_of


class Frames(Sequence[Frame]):
    """Frames of a recording or a simulation, like a list: `frames[3]`, `frames[-1]`, `frames[::2]`.

    A frame is read on access, and not kept in memory. Slices share the open file.

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
        Of the source, if it is a file.
    note : str
        Missing parts of a recording and other warnings; empty for none.
    """

    def __init__(self, source: FrameSource, chosen: range | None = None) -> None:
        self.source = source
        self.chosen = range(len(source)) if chosen is None else chosen
        self.name = source.name
        self.path: Path | None = getattr(source, "path", None)
        self.note: str = getattr(source, "note", "")

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.chosen)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Self: ...
    def __getitem__(self, index: int | slice) -> Frame | Self:
        """One frame, or a slice of frames.

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
            raise IndexError(
                f"frame {index}: {self.name} has {count_of(len(self), 'frame')}, counted from 0"
            ) from None
        return self.source[chosen]

    @property
    def times_s(self) -> np.ndarray:
        """Time of each frame from the start of the source, s, (F,)."""
        return self.source.times_s[self.chosen]

    def close(self) -> None:
        """Close the file, which all slices share."""
        self.source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{count_of(len(self), 'frame')} of {self.name}>"


def open(
    path: str | Path,
    frames: str | None = None,
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
        in m) or a point cloud and optionally camera info, gas pressure and wrench; or a format of a
        plug-in.
    frames : str, optional
        Frames A to B−1, counted from 0, as A:B or A:B:STEP; all by default.
    depth_topic : str, optional
        Topic of the depth images; by default the first.
    info_topic, pressure_topic, wrench_topic : str, optional
        Other topics; by default those most similar in name to the depth topic.

    Returns
    -------
    Frames
        With `depth_m` (H, W) in m, `gas_pressure_pa` (absolute), `wrench` (6,) in N and N·m.

    Raises
    ------
    InputError
        The file is missing, damaged or truncated, or has no depth images or no such frames.

    Examples
    --------
    >>> press = bv.open("press.mcap")
    >>> press[-1].depth_m.shape
    (171, 224)
    """
    recording = open_recording(
        path,
        depth_topic=depth_topic,
        info_topic=info_topic,
        pressure_topic=pressure_topic,
        wrench_topic=wrench_topic,
    )
    try:
        return Frames(recording, parse_frames(frames, len(recording), str(path)))
    except InputError:
        recording.close()
        raise


def parse_frames(text: str | None, count: int, name: str, option: str = "--frames") -> range:
    """Range of frames `A:B` or `A:B:STEP`, B excluded, out of `count`; all if None.

    An empty A means the first frame, an empty B the last. Raises InputError: invalid range.
    """
    if text is None:
        return range(count)
    if not isinstance(text, str):
        raise InputError(f"{option} {text}: give a text A:B or A:B:STEP, or a slice of the frames")
    given, parts = f'{option} "{text}"', [part.strip() for part in text.split(":")]
    if len(parts) not in (2, 3) or not all(p.isascii() and p.isdigit() for p in parts if p):
        raise InputError(f"{given}: give A:B or A:B:STEP, such as 0:60 for frames 0 to 59")
    start, stop, step = (
        int(part) if part else default
        for part, default in zip([*parts, ""][:3], (0, count, 1), strict=True)
    )
    if step < 1:
        raise InputError(f"{given}: give a step of 1 or more")
    if stop > count or start >= count:
        frames = count_of(count, "frame")
        raise InputError(f"{name}: {given} is outside its {frames}; choose within 0:{count}")
    if start >= stop:
        raise InputError(f"{given}: contains no frame; choose A below B")
    return range(start, stop, step)


@dataclass(frozen=True)
class ColourInfo:
    """Facts of the colour images of a recording."""

    topic: str
    encoding: str
    images: int
    rate_hz: float | None  # one over the median period; None: fewer than two images
    width: int
    height: int
    intrinsics: Intrinsics | None
    T_D_C: list[list[float]]  # pose of the colour camera in the depth camera, (4, 4)
    remark: str  # assumptions about parameters of its camera that were not recorded

    @classmethod
    def of(cls, recording: Recording) -> ColourInfo | None:
        """Facts of the colour images of an open recording; None if it has none."""
        colour = recording.colour
        if colour is None:
            return None
        camera = colour.camera
        return cls(
            colour.topic.name,
            colour.encoding,
            len(colour),
            colour.rate_hz,
            *colour.size,
            camera.intrinsics,
            camera.T_D_C.tolist(),
            camera.remark,
        )

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        rate = f", {self.rate_hz:.2f} Hz" if self.rate_hz else ""
        parts = (
            f"{self.width} × {self.height} pixels, {self.encoding}, {self.topic}",
            f"{count_of(self.images, 'image')}{rate}",
            self.remark,
        )
        return "; ".join(filter(None, parts))


@dataclass(frozen=True)
class RecordingInfo(Summary):
    """Facts of a recording."""

    path: str
    topics: tuple[Topic, ...]
    depth_topic: str
    encoding: str  # of the depth images
    frames: int
    duration_s: float  # from the first to the last frame
    rate_hz: float | None  # one over the median period; None: fewer than two frames
    size_bytes: int
    width: int
    height: int
    gaps: int  # missing frames
    gap_positions: tuple[Gap, ...]
    intrinsics: Intrinsics | None
    gas_pressure_pa: tuple[float, float] | None  # lowest and highest, absolute
    wrench: bool
    colour: ColourInfo | None
    bad_frames: tuple[int, ...] = ()  # without data, as the message is too short for an image
    note: str = ""  # missing parts of the recording; empty if it is complete

    def __repr__(self) -> str:
        frames, size = count_of(self.frames, "frame"), f"{self.width}×{self.height} pixels"
        return f"<{self.path}: {frames} in {self.duration_s:.3f} s, {size}>"

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        rate = "–" if self.rate_hz is None else f"{self.rate_hz:.2f} Hz"
        facts = {
            "recording": self.path,
            "frames": f"{self.frames} in {self.duration_s:.3f} s, {rate}",
            "gaps": self._gaps_text(),
            "image": f"{self.width} × {self.height} pixels, {self.encoding}, {self.depth_topic}",
            "intrinsics": _intrinsics_text(self.intrinsics),
            "gas pressure": _pressure_text(self.gas_pressure_pa),
            "wrench": "recorded" if self.wrench else "not recorded",
            "colour": "not recorded" if self.colour is None else self.colour.to_text(),
            "size": f"{self.size_bytes / 1e6:.1f} MB",
            **({"bad frames": self._bad_text()} if self.bad_frames else {}),
            **({"note": self.note} if self.note else {}),
        }
        width = max(len(topic.name) for topic in self.topics)
        lines = [f"{label:<13} {text}" for label, text in facts.items()]
        lines += ["topics", *(f"  {t.name:<{width}}  {t.count:>8}  {t.type}" for t in self.topics)]
        return "\n".join(lines)

    def _bad_text(self) -> str:
        shown = ", ".join(map(str, self.bad_frames[:20]))
        more = len(self.bad_frames) - 20
        which = shown + (f" and {more} more" if more > 0 else "")
        return f"{len(self.bad_frames)} without a depth image: {which}"

    def _gaps_text(self) -> str:
        if not self.gaps:
            return "no missing frames"
        places = [f"{g.missing} after frame {g.after_frame}" for g in self.gap_positions[:10]]
        more = len(self.gap_positions) - len(places)
        others = f" and {count_of(more, 'more gap')}" if more else ""
        return f"{count_of(self.gaps, 'missing frame')}: {', '.join(places)}{others}"


def info(recording: str | Path | Frames | Recording) -> RecordingInfo:
    """List topics, frames, rate and gaps of a recording.

    Parameters
    ----------
    recording : path, Frames or Recording
        Facts refer to the entire recording, also for a slice of its frames.

    Raises
    ------
    InputError
        The recording cannot be read.
    """
    if isinstance(recording, str | Path):
        with Recording(recording) as opened:
            return info(opened)
    check_type("recording", recording, str, Path, Frames, Recording)
    source = recording.source if isinstance(recording, Frames) else recording
    if not isinstance(source, Recording):
        raise InputError(
            f"{source.name}: info needs a ROS recording; save these frames as one, or give another"
        )
    times = source.times_s
    gaps, period = find_gaps(times), usual_step(np.diff(times))
    pressures = source.gas_pressures_pa()
    extremes = (float(pressures.min()), float(pressures.max())) if len(pressures) else None
    return RecordingInfo(
        path=str(source.path),
        topics=source.bag.topics,
        depth_topic=source.depth_topic.name,
        encoding=source.encoding,
        frames=len(source),
        duration_s=float(times[-1] - times[0]),
        rate_hz=None if period is None else 1.0 / period,
        size_bytes=source.bag.size_bytes,
        width=source.size[0],
        height=source.size[1],
        gaps=sum(gap.missing for gap in gaps),
        gap_positions=gaps,
        intrinsics=source.intrinsics,
        gas_pressure_pa=extremes,
        wrench=source.has_wrench,
        colour=ColourInfo.of(source),
        bad_frames=source.bad_frames,
        note=source.note,
    )


def _intrinsics_text(camera: Intrinsics | None) -> str:
    if camera is None:
        return "no calibrated camera info of this image size"
    return (
        f"fx {camera.fx:.2f}, fy {camera.fy:.2f}, cx {camera.cx:.2f}, cy {camera.cy:.2f} "
        f"pixels, distortion {camera.distortion_model}"
    )


def _pressure_text(extremes_pa: tuple[float, float] | None) -> str:
    if extremes_pa is None:
        return "not recorded"
    low, high = extremes_pa
    return f"{low / 1e3:.3f} … {high / 1e3:.3f} kPa absolute"
