"""Conversion of recordings, and of folders of depth images, to MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bubbleviz.api.frames import RecordingInfo, info
from bubbleviz.errors import InputError, check_given
from bubbleviz.files import refuse_existing, refuse_input
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import (
    Encoding,
    FrameSource,
    ImageFolder,
    Recording,
    RecordingWriter,
    is_image_folder,
)


def convert(
    source: str | Path,
    out: str | Path,
    *,
    intrinsics: str | Path | None = None,
    times: str | Path | None = None,
    gas_pressure: str | Path | None = None,
    wrench: str | Path | None = None,
    rate_hz: float | None = None,
    metres_per_unit: float | None = None,
    overwrite: bool = False,
    progress: Progress = quiet,
) -> RecordingInfo:
    """Convert depth images or another recording to MCAP.

    Depth, colour, camera info, gas pressure and wrench are kept, the last two at the times of the
    frames.

    Parameters
    ----------
    source : path
        A folder of depth images (.npy, 16-bit .png or .tif, in the order of the numbers in their
        names), a ROS 1 or RealSense .bag, or a rosbag2 .db3.
    out : path
        `X.mcap`, or a new folder for a rosbag2.
    intrinsics : path, optional
        Sensor file or preset, or TOML or JSON with width, height, fx, fy, cx, cy,
        distortion_model and distortion; by default intrinsics.toml or .json in the folder of
        images.
    times : path, optional
        CSV with a time in s for each image; by default times.csv in the folder, or the file names.
    gas_pressure : path, optional
        CSV of time in s and absolute gas pressure in Pa, to add to images.
    wrench : path, optional
        CSV of time in s, forces x y z in N, torques in N·m, to add to images.
    rate_hz : float, optional
        Images per second, instead of `times`.
    metres_per_unit : float, optional
        Depth of a pixel value of 1, 1 µm to 1 m; by default 0.001 for integers, 1 for floats.
    overwrite : bool
        Replace existing files.
    progress : Progress

    Returns
    -------
    RecordingInfo
        Of `out`.

    Raises
    ------
    InputError
        An input cannot be read or does not match the others, or `out` exists; nothing is written.
    """
    check_given("--rate", rate_hz, 0.01, 1e4)
    check_given("--metres-per-unit", metres_per_unit, 1e-6, 1.0)
    refuse_input(out, source)
    refuse_existing(out, ".mcap", "", overwrite=overwrite)
    source = Path(source)
    progress("opening", 0.0)
    options: dict[str, Any] = {
        "intrinsics": intrinsics,
        "times": times,
        "gas_pressure": gas_pressure,
        "wrench": wrench,
        "rate_hz": rate_hz,
        "metres_per_unit": metres_per_unit,
    }
    if is_image_folder(source):
        images = ImageFolder(source, **options)
        return _written(images, out, progress, images.whole_millimetres, overwrite=overwrite)
    if any(option is not None for option in options.values()):
        raise InputError(
            f"{source}: not a folder of depth images, and only these take --intrinsics, --rate, "
            "--times, --metres-per-unit, --gas-pressure and --wrench; correct the path, or leave "
            "those options out"
        )
    with Recording(source) as recording:
        whole_millimetres = recording.encoding == "16UC1"
        return _written(recording, out, progress, whole_millimetres, overwrite=overwrite)


def _written(
    source: FrameSource,
    out: str | Path,
    progress: Progress,
    whole_millimetres: bool,
    *,
    overwrite: bool,
) -> RecordingInfo:
    encoding: Encoding = "16UC1" if whole_millimetres else "32FC1"
    with RecordingWriter(out, encoding=encoding, overwrite=overwrite) as writer:
        for index in range(len(source)):
            progress("converting", index / len(source))
            writer.write(source[index])
    return info(out)
