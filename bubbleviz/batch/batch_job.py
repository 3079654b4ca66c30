"""One recording of a batch: estimated into its own folder, which is written atomically."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path

import bubbleviz
from bubbleviz.batch.summary_row import Row
from bubbleviz.calibration.sensor_writer import file_hash
from bubbleviz.commands.estimate import estimate_recording
from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.output_files import whole_file
from bubbleviz.frames.sensor_matching import checked_sensor
from bubbleviz.sensor import sensor_to_toml

RESULT, TABLE, SUMMARY = "result.npz", "result.csv", "summary.json"
"""Files in the folder of a recording's result."""


@dataclass(frozen=True)
class Settings:
    """What all recordings of a batch are estimated with.

    Attributes
    ----------
    sensor : str
        File or preset; `auto` for the preset that fits each recording.
    kappa : float or None
    solver : str or None
    frames : str or None
        As in `bubbleviz.commands.estimate.parse_frames`.
    friction : float or None
        Coefficient of friction to expect of contacts; None for the default.
    """

    sensor: str
    kappa: float | None = None
    solver: str | None = None
    frames: str | None = None
    friction: float | None = None


@dataclass(frozen=True)
class Job:
    """A recording to estimate.

    Attributes
    ----------
    name : str
        Path of the recording below the batch's folder.
    recording : str
        Where it is.
    out : str
        Folder of its result.
    settings : Settings
    """

    name: str
    recording: str
    out: str
    settings: Settings


def run_job(job: Job) -> Row:
    """Estimate a recording unless a result of the same recording and settings is there.

    Never raises because of the recording: its row says what is wrong.
    """
    try:
        return _run(job)
    except InputError as error:
        return Row(job.name, "bad_input", error=_sentence(error))
    except SolveError as error:
        return Row(job.name, "failed", error=_sentence(error))
    except Exception as error:  # the others of the batch do not depend on it
        return Row(job.name, "failed", error=f"{type(error).__name__}: {_sentence(error)}")


def finished(out: Path, key: str) -> Row | None:
    """Row of the result in a folder, where it was made of the same recording and settings."""
    if not (out / RESULT).is_file():
        return None
    try:
        said = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
        row = Row.from_dict(said["row"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return replace(row, outcome="kept") if said.get("key") == key else None


def _run(job: Job) -> Row:
    asked, out = job.settings, Path(job.out)
    sensor_name, sensor = checked_sensor(job.recording, asked.sensor)
    named = [sensor.membrane.mesh_file, sensor.calibration and sensor.calibration.pixels_file]
    files = [sensor.resolve(file) for file in named if file]
    key = _key([Path(job.recording), *files], sensor_to_toml(sensor), asked)
    kept = finished(out, key)
    if kept is not None:
        return kept
    try:
        return _estimated(job, sensor_name, key)
    except InputError:
        kept = finished(out, key)  # a worker that was thought to be lost was faster
        if kept is None:
            raise
        return kept


def _estimated(job: Job, sensor_name: str, key: str) -> Row:
    asked, out = job.settings, Path(job.out)
    _make_room(out)
    with whole_file(out) as folder:
        folder.mkdir()
        summary = estimate_recording(
            job.recording,
            sensor_name,
            folder / RESULT,
            folder / TABLE,
            kappa=asked.kappa,
            solver=asked.solver,
            frames=asked.frames,
            friction=asked.friction,
        )
        row = Row.of_result(job.name, sensor_name, folder / RESULT, summary.warning or "")
        said = f'{{"key": "{key}", "row": {row.to_json()}}}\n'
        (folder / SUMMARY).write_text(said, encoding="utf-8")
    return row


def _key(files: list[Path], sensor_toml: str, settings: Settings) -> str:
    """Hash of all that a result depends on."""
    choices = {**asdict(settings), "sensor": sensor_toml, "version": bubbleviz.__version__}
    parts = [*map(file_hash, files), json.dumps(choices, sort_keys=True)]
    return sha256("\n".join(parts).encode()).hexdigest()


def _make_room(out: Path) -> None:
    """Remove a result of other settings; anything else at its place is not ours to remove."""
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.is_dir() and {path.name for path in out.iterdir()} <= {RESULT, TABLE, SUMMARY}:
        shutil.rmtree(out)


def _sentence(error: Exception) -> str:
    return " ".join(str(error).split())
