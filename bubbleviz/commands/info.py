"""Summary of a recording: topics, frames, rate, duration, size, gaps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.colour.recorded_colour import RecordedColour
from bubbleviz.colour.temporal_lag import TemporalLag, temporal_lag
from bubbleviz.commands.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.frames.bags import Topic
from bubbleviz.frames.gaps import Gap, find_gaps, usual_step
from bubbleviz.frames.recording import Recording
from bubbleviz.wording import count_of


@dataclass(frozen=True)
class ColourInfo:
    """Facts of the colour images of a recording.

    Attributes
    ----------
    topic, encoding : str
    images : int
    rate_hz : float or None
        One over the median period; None for fewer than two images.
    width, height : int
        Pixels.
    intrinsics : Intrinsics or None
    T_D_C : list of list of float
        Pose of the colour camera in the depth camera, (4, 4).
    remark : str
        What of its camera was not recorded and is taken for granted.
    lag : TemporalLag or None
        Delay of the images that is seen; None where it was not asked for or is not seen.
    no_lag : str
        Why it is not seen; empty where it is, or was not asked for.
    """

    topic: str
    encoding: str
    images: int
    rate_hz: float | None
    width: int
    height: int
    intrinsics: Intrinsics | None
    T_D_C: list[list[float]]
    remark: str
    lag: TemporalLag | None = None
    no_lag: str = ""

    @classmethod
    def of(cls, recording: Recording, colour: RecordedColour, *, lag: bool) -> ColourInfo:
        """Facts of the colour images of an open recording."""
        seen, unseen = None, ""
        if lag:
            try:
                seen = temporal_lag(recording)
            except InputError as error:  # a recording that does not show it is none the worse
                unseen = str(error).removeprefix(f"{recording.path}: ")
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
            seen,
            unseen,
        )

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        parts = [
            f"{self.width} × {self.height} pixels, {self.encoding}, {self.topic}",
            count_of(self.images, "image") + (f", {_hertz(self.rate_hz)}" if self.rate_hz else ""),
        ]
        parts.append(self.lag.to_text() if self.lag else "")
        parts.append(f"no colour delay seen: {self.no_lag}" if self.no_lag else "")
        return "; ".join(part for part in (*parts, self.remark) if part)


@dataclass(frozen=True)
class RecordingInfo(Summary):
    """Facts of a recording.

    Attributes
    ----------
    path : str
    topics : tuple of Topic
    depth_topic, encoding : str
        Topic and encoding of the depth images.
    frames : int
        Number of depth images.
    duration_s : float
        Time from the first to the last frame, s.
    rate_hz : float or None
        One over the median frame period; None for fewer than two frames.
    size_bytes : int
        Size of the files.
    width, height : int
        Image size, pixels.
    gaps : int
        Number of missing frames.
    gap_positions : tuple of Gap
        Where they are missing.
    intrinsics : Intrinsics or None
    gas_pressure_pa : (float, float) or None
        Lowest and highest recorded gas pressure, absolute, Pa.
    wrench : bool
        Whether a wrench was recorded.
    colour : ColourInfo or None
    note : str
        What is missing of the recording, in words; empty when it is whole.
    """

    path: str
    topics: tuple[Topic, ...]
    depth_topic: str
    encoding: str
    frames: int
    duration_s: float
    rate_hz: float | None
    size_bytes: int
    width: int
    height: int
    gaps: int
    gap_positions: tuple[Gap, ...]
    intrinsics: Intrinsics | None
    gas_pressure_pa: tuple[float, float] | None
    wrench: bool
    colour: ColourInfo | None
    note: str = ""

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        rate = "–" if self.rate_hz is None else _hertz(self.rate_hz)
        facts = [
            ("recording", self.path),
            ("frames", f"{self.frames} in {self.duration_s:.3f} s, {rate}"),
            ("gaps", self._gaps_text()),
            ("image", f"{self.width} × {self.height} pixels, {self.encoding}, {self.depth_topic}"),
            ("intrinsics", self._intrinsics_text()),
            ("gas pressure", self._pressure_text()),
            ("wrench", "recorded" if self.wrench else "not recorded"),
            ("colour", "not recorded" if self.colour is None else self.colour.to_text()),
            ("size", f"{self.size_bytes / 1e6:.1f} MB"),
        ]
        if self.note:
            facts.append(("note", self.note))
        lines = [f"{label:<13} {text}" for label, text in facts]
        width = max(len(topic.name) for topic in self.topics)
        lines += ["topics"]
        lines += [f"  {t.name:<{width}}  {t.count:>8}  {t.type}" for t in self.topics]
        return "\n".join(lines)

    def _gaps_text(self) -> str:
        if not self.gaps:
            return "no missing frames"
        places = [f"{g.missing} after frame {g.after_frame}" for g in self.gap_positions[:10]]
        more = len(self.gap_positions) - len(places)
        return f"{self.gaps} missing: {', '.join(places)}" + (f" and {more} more" if more else "")

    def _intrinsics_text(self) -> str:
        camera = self.intrinsics
        if camera is None:
            return "not recorded"
        return (
            f"fx {camera.fx:.2f}, fy {camera.fy:.2f}, cx {camera.cx:.2f}, cy {camera.cy:.2f} "
            f"pixels, distortion {camera.distortion_model}"
        )

    def _pressure_text(self) -> str:
        if self.gas_pressure_pa is None:
            return "not recorded"
        low, high = self.gas_pressure_pa
        return f"{low / 1e3:.3f} … {high / 1e3:.3f} kPa absolute"


def recording_info(recording: Recording | str | Path, *, lag: bool = False) -> RecordingInfo:
    """Facts of a recording, open or by its path.

    Parameters
    ----------
    recording : Recording or path-like
    lag : bool
        Look for the delay of its colour images, which reads the images of the first contact.

    Raises
    ------
    InputError
        The recording cannot be read.
    """
    if not isinstance(recording, Recording):
        with Recording(recording) as opened:
            return recording_info(opened, lag=lag)
    colour, times = recording.colour, recording.times_s
    gaps = find_gaps(times)
    pressures = recording.gas_pressures_pa()
    extremes = (float(pressures.min()), float(pressures.max())) if len(pressures) else None
    return RecordingInfo(
        path=str(recording.path),
        topics=recording.bag.topics,
        depth_topic=recording.depth_topic.name,
        encoding=recording.encoding,
        frames=len(recording),
        duration_s=float(times[-1] - times[0]),
        rate_hz=_rate(times),
        size_bytes=recording.bag.size_bytes,
        width=recording.size[0],
        height=recording.size[1],
        gaps=sum(gap.missing for gap in gaps),
        gap_positions=gaps,
        intrinsics=recording.intrinsics,
        gas_pressure_pa=extremes,
        wrench=recording.has_wrench,
        colour=None if colour is None else ColourInfo.of(recording, colour, lag=lag),
        note=recording.bag.note,
    )


def _hertz(rate_hz: float) -> str:
    return f"{rate_hz:.2f} Hz"


def _rate(times_s: np.ndarray) -> float | None:
    period = usual_step(np.diff(times_s))
    return None if period is None else 1.0 / period
