"""The work of `bubbleviz identify`: a recording of the untouched sensor in, a sensor file out."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bubbleviz.calibration.identification import (
    Identification,
    collect_press,
    identify,
    with_rubber,
)
from bubbleviz.calibration.rectification import Level, rectify
from bubbleviz.calibration.rubber.vented import Vented
from bubbleviz.calibration.save_identification import check_outputs, save
from bubbleviz.calibration.surface.reference_surface import Name
from bubbleviz.calibration.validation import KnownPress
from bubbleviz.errors import InputError
from bubbleviz.files.pose_reader import parse_pose
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.kept_frames import KeptFrames
from bubbleviz.frames.recording import Recording
from bubbleviz.progress import Progress, quiet
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Sensor, load_sensor


@dataclass(frozen=True)
class IdentifySummary:
    """What `identify` found and wrote.

    Attributes
    ----------
    numbers : dict
        Of the report, SI units.
    out : Path
    report : Path or None
    """

    numbers: dict[str, Any]
    out: Path
    report: Path | None

    def to_json(self) -> str:
        """The numbers as JSON."""
        return json.dumps(self.numbers, indent=2, ensure_ascii=False)

    def to_text(self) -> str:
        """Verdict and advice for people, and what was written."""
        verdict = self.numbers["verdict"]
        report = f" and {self.report / 'report.html'}" if self.report else ""
        advice = (f"- {line}" for line in verdict["advice"])
        return "\n".join([verdict["summary"], *advice, f"wrote {self.out}{report}"])


def identify_recording(
    recording: str | Path,
    sensor_name: str,
    out: Path,
    report: Path | None = None,
    *,
    contact_free: str | None = None,
    surface: Name | None = None,
    nodes: int = 1000,
    levels: Sequence[Path] = (),
    vented: Path | None = None,
    held_press: bool = True,
    press: KnownPress | None = None,
    progress: Progress = quiet,
) -> IdentifySummary:
    """Identify the sensor of a recording and write its file, and a report where asked for.

    Parameters
    ----------
    recording : str or path
    sensor_name : str
        Sensor file or preset to start from.
    out, report : Path
        SENSOR.toml and a folder; neither may exist.
    contact_free : str, optional
        Frames as in `parse_range`; found where not given.
    surface, nodes
        As of `bubbleviz.calibration.identification.identify`.
    levels : sequence of Path
        Recordings of the untouched sensor at other inflation levels.
    vented : Path, optional
        Recording of the gas pressure with the chamber open to the atmosphere.
    held_press : bool
        Whether a held press in the recording is asked for λ and gauge pressure where there are no
        levels.
    press : KnownPress, optional
        What to validate by, in the same recording.
    progress : Progress

    Raises
    ------
    InputError
        Something given does not exist or does not fit together, or makes the answer worthless;
        nothing is written then.
    """
    check_outputs(out, report)
    sensor = load_sensor(sensor_name)
    chosen = None if contact_free is None else parse_range("--contact-free", contact_free)
    opened = None
    if vented is not None:
        with Recording(vented) as open_chamber:
            opened = Vented.measure(open_chamber)
        sensor = opened.set_in(sensor)
    with Recording(recording) as file:
        source = KeptFrames(file)
        found = identify_with_levels(
            source,
            sensor,
            chosen,
            nodes=nodes,
            surface=surface,
            levels=_opened(levels),
            vented=opened,
            held_press=held_press,
            progress=progress,
        )
        validation = None
        if press is not None:
            progress("predicting the known press", 0.0)
            validation = press.validate(found.model, source)
        numbers = save(found, source, sensor_name, out, report, progress, validation)
    return IdentifySummary(numbers, out, report)


def identify_with_levels(
    source: FrameSource,
    sensor: Sensor,
    contact_free: Sequence[int] | None,
    *,
    nodes: int,
    surface: Name | None,
    levels: Iterable[FrameSource],
    vented: Vented | None,
    held_press: bool,
    progress: Progress,
) -> Identification:
    """`identify`, then pixels rectified by other levels, and rubber by them or by a press.

    Parameters
    ----------
    source, sensor, contact_free, nodes, surface, progress
        As of `bubbleviz.calibration.identification.identify`; the sensor has the atmospheric
        pressure of the open chamber, where that is given.
    levels : iterable of FrameSource
        Of the untouched sensor at other pressures.
    vented : Vented or None
    held_press : bool
        Whether a held press in the source is asked where there are no levels.

    Raises
    ------
    InputError
        As of `identify`, `Level.measure`, `rectify` and `with_rubber`.
    """
    found = identify(source, sensor, contact_free, nodes=nodes, surface=surface, progress=progress)
    measured = [Level.measure(KeptFrames(level), sensor, nodes, progress) for level in levels]
    found = rectify(found, measured)
    held = collect_press(source, found, progress) if held_press else None
    progress("stretching rubber", 0.0)
    inflated = [each.samples for each in measured if each.samples]
    return with_rubber(found, inflated, vented, held)


def _opened(paths: Sequence[Path]) -> Iterator[Recording]:
    """Recordings, each open while it is looked at."""
    for path in paths:
        with Recording(path) as recording:
            yield recording


def known_press(obj: str, pose: str, pressed: str) -> KnownPress:
    """What to validate by, refused before the work where it cannot be read.

    Parameters
    ----------
    obj : str
        Mesh file or preset.
    pose : str
        T_B_O as `parse_pose` reads it.
    pressed : str
        Frames as in `parse_range`.

    Raises
    ------
    InputError
        No such object, or pose or frames cannot be read.
    """
    load_object(obj), parse_pose(pose)
    frames = parse_range("--pressed", pressed)
    return KnownPress(obj, pose, frames.start, frames.stop)


def parse_range(option: str, text: str) -> range:
    """Frames of "A:B", A to B−1; InputError where it is not that."""
    match = re.fullmatch(r"(\d+):(\d+)", text.strip())
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(f"{option} {text}: give A:B with A < B, for example 0:100")
    return range(int(match[1]), int(match[2]))
