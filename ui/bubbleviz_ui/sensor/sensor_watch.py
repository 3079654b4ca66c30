"""Detects changes on disk of the files of the sensor in use."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QFileSystemWatcher, QObject, QTimer, Signal

from bubbleviz.errors import InputError
from bubbleviz.sensor import Sensor, load_sensor

WRITE_DELAY_MS = 200
"""Delay before comparing, as editors write a file in several steps."""
RELOAD = "press Reload in the Sensor panel to use"


class SensorWatch(QObject):
    """Compares a sensor with its file, mesh and pixels whenever they or their folder change."""

    changed = Signal(str)  # What changed, to follow the file name; empty: no difference

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._sensor: Sensor | None = None
        self._difference = ""
        self._written: dict[str, int] = {}
        self._files = QFileSystemWatcher(self)
        self._due = QTimer(self, singleShot=True, interval=WRITE_DELAY_MS)
        self._due.timeout.connect(self._compare)
        self._files.fileChanged.connect(self._due.start)
        self._files.directoryChanged.connect(self._due.start)

    def watch(self, sensor: Sensor) -> None:
        if watched := [*self._files.files(), *self._files.directories()]:
            self._files.removePaths(watched)
        self._sensor, self._difference = sensor, ""
        if sensor.file:
            self._files.addPath(str(sensor.folder.absolute()))
            self._written = _written(sensor)
            self._compare()

    def _compare(self) -> None:
        if self._sensor is None or not self._sensor.file:
            return
        path = self._sensor.resolve(self._sensor.file).absolute()
        written = _written(self._sensor)
        # many editors replace the file
        self._files.addPaths([str(path), *written])
        difference = _difference(self._sensor, path)
        if not difference and written != self._written:
            change = f"changed on disk; {RELOAD} them"
            if not all(written.values()):
                change = "been removed or renamed; the sensor stays in use"
            difference = f"its mesh or pixels have {change}"
        if difference != self._difference:
            self._difference = difference
            self.changed.emit(difference)


def _difference(sensor: Sensor, path: Path) -> str:
    if not path.exists():
        return "was removed or renamed; the sensor stays in use"
    try:
        if load_sensor(path).model_copy(update={"folder": sensor.folder}) == sensor:
            return ""
    except InputError as error:
        why = str(error).removeprefix(f"{path}: ")
        return f"has changed on disk and cannot be used: {why}"
    return f"has changed on disk; {RELOAD} it"


def _written(sensor: Sensor) -> dict[str, int]:
    """Modification times of mesh and pixels, ns since 1970; 0: missing."""
    calibration = sensor.calibration
    named = (sensor.membrane.mesh_file, calibration and calibration.pixels_file)
    paths = [sensor.resolve(file).absolute() for file in named if file]
    return {str(path): path.stat().st_mtime_ns if path.exists() else 0 for path in paths}
