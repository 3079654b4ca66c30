"""Sensor panel: which sensor is in use, what its file says, and a copy with other values."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.errors import InputError
from bubbleviz.sensor import Sensor, edited, save_sensor
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.requests import Opened
from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import SYSTEMS
from bubbleviz_ui.panels.control_input import watch_controls
from bubbleviz_ui.sensor.sensor_text import VALUES, file_text, identified_text
from bubbleviz_ui.sensor.sensor_watch import SensorWatch
from bubbleviz_ui.sensor.value_row import ValueRow
from bubbleviz_ui.shell.file_dialogs import new_file
from bubbleviz_ui.shell.layouts import fill


class SensorPanel(QWidget):
    """The sensor that the other panels show.

    Attributes
    ----------
    said : Signal
        A `UserMessage`.
    """

    said = Signal(object)

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._opening = state, controller.opening
        self._copied: Sensor | None = None  # while a copy of it is edited
        self.name, self.file = QLineEdit(), QLineEdit(readOnly=True)
        self.camera, self.identified, self.difference = QLabel(), QLabel(), QLabel()
        self.recording = QLineEdit(readOnly=True)
        self.rows = {value.key: ValueRow(value, state.units) for value in VALUES}
        self.problem = QLabel(wordWrap=True)
        self.edit, self.reload = QPushButton("Edit a copy…"), QPushButton("Reload")
        self.save, self.cancel = QPushButton("Save as…"), QPushButton("Cancel")
        self._watch = SensorWatch(self)
        self._lay_out()
        watch_controls(self)
        self._show()
        self.edit.clicked.connect(self._begin)
        self.reload.clicked.connect(self._reload)
        self.save.clicked.connect(self._choose_file)
        self.cancel.clicked.connect(self._end)
        for box in (self.name, *(row.box for row in self.rows.values())):
            box.textEdited.connect(self._check)
        self._watch.told.connect(self._on_difference)
        controller.opened.connect(self._on_opened)
        state.choices_changed.connect(self._on_choices)

    def _lay_out(self) -> None:
        self.name.setToolTip("Name of the sensor")
        self.edit.setToolTip("Change values and save them as a new sensor file; this one stays")
        self.reload.setToolTip("Read the sensor file anew")
        self.save.setToolTip("Write a sensor file, with its mesh and pixels, and use it")
        self.cancel.setToolTip("Leave the values as they are")
        for label in (self.problem, self.difference):
            label.setObjectName("doubt")
        self._form = form = QFormLayout()
        form.addRow("Name", self.name)
        form.addRow("File", self.file)
        form.addRow("Camera", self.camera)
        for row in self.rows.values():
            form.addRow(row.value.title, row)
            form.addRow("95 % interval", row.interval)
        form.addRow("Identified", self.identified)
        form.addRow("from", self.recording)
        buttons = fill(QHBoxLayout(), self.edit, self.reload, self.save, self.cancel, 1)
        fill(QVBoxLayout(self), self.difference, form, self.problem, buttons, 1)

    @property
    def _sensor(self) -> Sensor | None:
        """What is shown: the sensor that is copied, else the one in use."""
        return self._copied or self._opening.sensor

    def _show(self) -> None:
        sensor, editing = self._sensor, self._copied is not None
        self.problem.hide()
        self.difference.setVisible(bool(self.difference.text()))
        self.name.setReadOnly(not editing)
        recording = (sensor and sensor.calibration and sensor.calibration.recording) or ""
        for told in (self.camera, self.identified):
            self._form.setRowVisible(told, not editing)
        self._form.setRowVisible(self.recording, bool(recording) and not editing)
        self.recording.setText(recording)
        for button, there in (
            (self.edit, not editing),
            (self.reload, not editing),
            (self.save, editing),
            (self.cancel, editing),
        ):
            button.setVisible(there)
            button.setEnabled(sensor is not None)
        if sensor is None:
            return
        self.reload.setEnabled(bool(sensor.file))
        self._show_file(sensor)
        camera = sensor.camera
        self.camera.setText(f"{camera.width}×{camera.height} pixels")
        self.camera.setToolTip(f"Focal lengths {camera.fx:.1f} and {camera.fy:.1f} pixels")
        self.identified.setText(identified_text(sensor))
        if not editing:
            self.name.setText(sensor.name)
            self.name.setCursorPosition(0)
        for row in self.rows.values():
            row.show_value(sensor, editing=editing)
            there = bool(row.interval.text()) and not editing
            self._form.setRowVisible(row.interval, there)

    def _show_file(self, sensor: Sensor) -> None:
        path, short = str(sensor.resolve(sensor.file).absolute()), file_text(sensor)
        is_path = short == sensor.file
        self.file.setText(path if is_path else short)
        self.file.setToolTip(path if sensor.file else "Calibration → Report saves it")

    # -- a copy -------------------------------------------------------------------------------

    def _begin(self) -> None:
        self._copied = self._opening.sensor
        self._show()
        if self._copied is not None:
            self.name.setText(f"{self._copied.name}, edited")

    def _end(self) -> None:
        self._copied = None
        self._show()

    def _check(self) -> Sensor | None:
        """The copy as it is typed; why it is none is said below the boxes."""
        if self._copied is None:
            return None
        typed = {key: row.read() for key, row in self.rows.items()}
        copy, problem = None, ""
        try:
            copy = edited(self._copied, {"name": self.name.text().strip(), **typed})
        except InputError as error:
            problem = str(error)
        self.problem.setText(problem)
        self.problem.setVisible(bool(problem))
        self.save.setEnabled(not problem)
        return copy

    def _choose_file(self) -> None:
        copy = self._check()
        if copy is None:
            return
        kinds = "Sensor files (*.toml)"
        path, _ = new_file(self, "Save sensor as", _proposed(copy), kinds, of="sensor")
        if path is not None:
            self._save(copy, path)

    def _save(self, copy: Sensor, path: Path) -> None:
        try:
            save_sensor(copy, path)
        except InputError as error:
            self.said.emit(UserMessage("error", str(error), topic="sensor file"))
            return
        self.said.emit(UserMessage("notice", f"Saved {path}", file=path, topic="sensor file"))
        self._end()
        self._opening.sensor_file(path)

    # -- the file -----------------------------------------------------------------------------

    @property
    def _opened_file(self) -> Path:
        sensor = self._opening.sensor
        return Path() if sensor is None else sensor.resolve(sensor.file).absolute()

    def _reload(self) -> None:
        self._opening.sensor_file(self._opened_file)

    def _on_opened(self, opened: Opened) -> None:
        self.difference.clear()
        self._watch.follow(opened.sensor)
        if self._copied is None:
            self._show()

    def _on_difference(self, difference: str) -> None:
        self.difference.setText(difference and "The sensor file on disk has changed")
        self.difference.setToolTip(difference)
        self.difference.setVisible(bool(difference))
        if difference:
            self.said.emit(UserMessage("warning", f"{self._opened_file}: {difference}"))

    def _on_choices(self, names: frozenset[str]) -> None:
        if names & SYSTEMS.keys():
            self._show()


def _proposed(sensor: Sensor) -> str:
    """Name for a copy: beside a file of the user's, else in the present folder."""
    name = f"{Path(sensor.file or 'sensor').stem}_edited.toml"
    return str(sensor.resolve(name).absolute()) if file_text(sensor) == sensor.file else name
