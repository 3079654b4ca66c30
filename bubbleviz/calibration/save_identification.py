"""Save an identification: sensor file, mesh, pixels and report, all of them or none."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.reports.identification_report import summary, write_report
from bubbleviz.calibration.sensor_writer import Origin, file_hash, output_files, write_sensor
from bubbleviz.calibration.validation import Validation
from bubbleviz.files.output_files import refuse_existing
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.progress import Progress, quiet


def check_outputs(out: Path, report: Path | None) -> None:
    """Refuse, before the work, what could not be written after it."""
    output_files(out)
    if report is not None:
        refuse_existing(report)


def save(
    found: Identification,
    source: FrameSource,
    sensor_file: str,
    out: Path,
    report: Path | None,
    progress: Progress = quiet,
    validation: Validation | None = None,
) -> dict[str, Any]:
    """Write the sensor at `out` and its report; the numbers of the report.

    Parameters
    ----------
    found : Identification
    source : FrameSource
        What it was made from; hashed where it is a file.
    sensor_file : str
        What it started from.
    out : path
        SENSOR.toml; its mesh and pixels go beside it.
    report : path, optional
        New folder.
    progress : Progress
    validation : Validation, optional
        By a known press.

    Raises
    ------
    InputError
        Something exists or cannot be written; nothing is written then.
    Cancelled
        By `progress`; nothing is written then.
    """
    check_outputs(out, report)
    path = getattr(source, "path", None)
    origin = Origin(
        recording=source.name,
        recording_sha256=None if path is None else file_hash(path),
        sensor_file=sensor_file,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        report=None if report is None else _from(out.parent, report / "report.html"),
    )
    numbers = summary(found, origin, validation)
    progress("writing", 0.0)
    write_sensor(found, out, origin)
    if report is not None:
        try:
            write_report(found, numbers, report, validation)
        except BaseException:
            for each in (out, out.with_suffix(".ply"), out.with_suffix(".npz")):
                each.unlink(missing_ok=True)  # none of them was there before
            raise
    return numbers


def _from(folder: Path, path: Path) -> str:
    """Path as seen from a folder, so that both can be moved together."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # on another drive
        return str(path)
