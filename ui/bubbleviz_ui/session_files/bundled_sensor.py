"""A sensor of no file of the user's, kept beside a session file. No Qt in here."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from bubbleviz.errors import InputError
from bubbleviz.files.output_files import whole_file
from bubbleviz.sensor import Sensor, sensor_to_toml

FILE = "sensor.toml"


def kept_beside(sensor: Sensor, file: Path) -> Path:
    """Copy a sensor, with the files it names, into a folder beside a session's file.

    The folder is named after the session and what is in it: another sensor gets another folder,
    and the same one costs nothing.

    Parameters
    ----------
    sensor : Sensor
    file : Path
        Of the session.

    Returns
    -------
    Path
        The sensor file in that folder.

    Raises
    ------
    InputError
        A file the sensor names is gone, or the copy cannot be written.
    """
    content = _content(sensor)
    digest = hashlib.sha256()
    for name, data in content.items():
        digest.update(name.encode() + b"\0" + data)
    folder = file.absolute().parent / f"{file.stem}_sensor_{digest.hexdigest()[:8]}"
    if not folder.exists():
        with whole_file(folder) as temporary:
            temporary.mkdir()
            for name, data in content.items():
                (temporary / name).write_bytes(data)
    return folder / FILE


def is_beside(sensor: Sensor, file: Path) -> bool:
    """Whether a sensor is one that was kept beside this session."""
    return sensor.folder.absolute() in _folders(file)


def forget_others(file: Path, kept: Path | None) -> None:
    """Remove the sensors once kept beside a session, but for the one that still is."""
    for folder in _folders(file):
        if kept is None or folder != kept.parent:
            shutil.rmtree(folder, ignore_errors=True)


def _folders(file: Path) -> list[Path]:
    return list(file.absolute().parent.glob(f"{file.stem}_sensor_????????"))


def _content(sensor: Sensor) -> dict[str, bytes]:
    """Bytes by name: the sensor's file and those it names, all in one folder."""
    membrane, calibration, content = sensor.membrane, sensor.calibration, dict[str, bytes]()
    if membrane.mesh_file is not None:
        name = Path(membrane.mesh_file).name
        content[name] = _read(sensor.resolve(membrane.mesh_file))
        membrane = membrane.model_copy(update={"mesh_file": name})
    if calibration is not None:
        name = Path(calibration.pixels_file).name
        content[name] = _read(sensor.resolve(calibration.pixels_file))
        calibration = calibration.model_copy(update={"pixels_file": name})
    alone = sensor.model_copy(update={"membrane": membrane, "calibration": calibration})
    return {**content, FILE: sensor_to_toml(alone).encode()}


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason}); save the sensor anew") from error
