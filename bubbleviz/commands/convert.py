"""The work of `bubbleviz convert`: any recording, or a folder of depth images, as MCAP."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bubbleviz.commands.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.files.output_files import refuse_existing
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.image_folder import (
    INTRINSICS,
    ImageFolder,
    is_image_folder,
    read_gas_pressure,
    read_intrinsics,
    read_times,
    read_wrench,
)
from bubbleviz.frames.message_encoding import Encoding
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.progress import Progress, quiet
from bubbleviz.wording import count_of


@dataclass(frozen=True)
class ConvertSummary(Summary):
    """Summary of a conversion.

    Attributes
    ----------
    out : str
    frames : int
    duration_s : float
    width, height : int
    has_intrinsics, has_gas_pressure, has_wrench, has_colour : bool
    """

    out: str
    frames: int
    duration_s: float
    width: int
    height: int
    has_intrinsics: bool
    has_gas_pressure: bool
    has_wrench: bool
    has_colour: bool

    def to_text(self) -> str:
        """Text for the terminal."""
        parts = {
            "intrinsics": self.has_intrinsics,
            "gas pressure": self.has_gas_pressure,
            "wrench": self.has_wrench,
            "colour": self.has_colour,
        }
        return (
            f"wrote {self.out}: {count_of(self.frames, 'frame')} of {self.width}×{self.height} "
            f"pixels lasting {self.duration_s:.3g} s"
            + "".join(f", {name}" for name, there in parts.items() if there)
        )


@dataclass(frozen=True)
class Beside:
    """What belongs to a folder of images; each may be missing.

    Attributes
    ----------
    intrinsics, times, gas_pressure, wrench : Path or None
        Files; see `bubbleviz.frames.image_folder`. Intrinsics and times are looked for in the
        folder, too, as `intrinsics.toml`, `intrinsics.json` and `times.csv`.
    rate_hz : float or None
        Of the images, where they have no times.
    metres_per_unit : float or None
    """

    intrinsics: Path | None = None
    times: Path | None = None
    gas_pressure: Path | None = None
    wrench: Path | None = None
    rate_hz: float | None = None
    metres_per_unit: float | None = None

    def images_of(self, folder: Path) -> ImageFolder:
        """The images of a folder with what belongs to them."""
        camera = self.intrinsics or _there(folder, *INTRINSICS)
        times = self.times or (None if self.rate_hz else _there(folder, "times.csv"))
        pressure, wrench = self.gas_pressure, self.wrench
        return ImageFolder(
            folder,
            intrinsics=None if camera is None else read_intrinsics(camera),
            times_s=None if times is None else read_times(times),
            rate_hz=self.rate_hz,
            metres_per_unit=self.metres_per_unit,
            gas_pressure=None if pressure is None else read_gas_pressure(pressure),
            wrench=None if wrench is None else read_wrench(wrench),
        )

    @property
    def anything(self) -> bool:
        """Whether anything is given."""
        return self != Beside()


def convert(
    source: str | Path, out: str | Path, beside: Beside | None = None, progress: Progress = quiet
) -> ConvertSummary:
    """Write the frames of a recording or of a folder of depth images as a recording.

    Parameters
    ----------
    source : path-like
        A folder of images, or whatever `Recording` opens.
    out : path-like
        `X.mcap`, or a new folder for a rosbag2.
    beside : Beside, optional
        For a folder of images.
    progress : Progress

    Raises
    ------
    InputError
        Something cannot be read or does not fit together, or `out` exists; nothing is written.
    """
    refuse_existing(out)
    source, beside = Path(source), beside or Beside()
    progress("opening", 0.0)
    if is_image_folder(source):
        images = beside.images_of(source)
        return _written(images, out, progress, whole_millimetres=images.whole_millimetres)
    if beside.anything:
        raise InputError(
            f"{source}: is no folder of images; intrinsics, times and measured values are its own"
        )
    with Recording(source) as recording:
        return _written(recording, out, progress, recording.encoding == "16UC1")


def _written(
    source: FrameSource, out: str | Path, progress: Progress, whole_millimetres: bool
) -> ConvertSummary:
    encoding: Encoding = "16UC1" if whole_millimetres else "32FC1"
    pressure = wrench = colour = False
    with RecordingWriter(out, encoding=encoding) as writer:
        for index in range(len(source)):
            progress("converting", index / len(source))
            frame = source[index]
            pressure |= frame.gas_pressure_pa is not None
            wrench |= frame.wrench is not None
            colour |= frame.colour is not None
            writer.write(frame)
    height, width = frame.depth_m.shape
    duration = float(source.times_s[-1])
    has_camera = frame.intrinsics is not None
    return ConvertSummary(
        str(out), len(source), duration, width, height, has_camera, pressure, wrench, colour
    )


def _there(folder: Path, *names: str) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)
