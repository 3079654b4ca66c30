"""Sensor panel: values of the sensor in use, and editing of a copy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path

from PySide6.QtWidgets import QFormLayout, QHBoxLayout, QLabel, QLineEdit, QVBoxLayout, QWidget

from bubbleviz.errors import InputError
from bubbleviz.sensor import Sensor, edited, save_sensor
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import file_text
from bubbleviz_ui.model.units import UNIT_CHOICES, Unit, Units
from bubbleviz_ui.sensor.sensor_watch import SensorWatch
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import new_file

# Texts about a sensor and its file. No Qt.


DIMENSIONLESS = Unit("", 1.0, 4)
NOT_IN_FILE = "not in the file"


@dataclass(frozen=True)
class Value:
    """A number of the sensor file."""

    key: str  # As in `bubbleviz.sensor.edited`
    title: str
    tip: str
    si: str = ""  # Unit in the file
    unit: str = ""  # Attribute of `Units`; empty if dimensionless
    # interval, source_key: Keys of `bubbleviz.sensor.Calibration` with its 95 % interval and
    # origin, or empty
    interval: str = ""
    source_key: str = ""


VALUES = (
    Value("pneumatics.gauge_pressure_pa", "Gauge pressure", "Gas pressure above the atmosphere, "
          "without contact", "Pa", "gas_pressure", "gauge_interval_pa", "gauge_from"),
    Value("pneumatics.tension_n_per_m", "Tension γ0", "Membrane tension at rest; without a value, "
          "computed from gauge pressure and curvature", "N/m", "tension",
          "tension_interval_n_per_m"),
    Value("membrane.prestretch", "Pre-stretch λ", "Stretch of the rubber at rest; without a "
          "value, the tension is constant", "", "", "prestretch_interval", "prestretch_from"),
    Value("membrane.sheet_share", "Sheet share", "Stress of an oval rim at rest, between that of "
          "a film, 0, and that of a flat sheet, 1", "", "", "sheet_share_interval",
          "prestretch_from"),
    Value("membrane.unequal_tension_x", "Unequal tension x", "By unequal stretch: tension along x "
          "minus along y, over their sum", "", "", "unequal_tension_x_interval", "prestretch_from"),
    Value("membrane.unequal_tension_xy", "Unequal tension xy", "By unequal stretch: twice the "
          "shear tension of x and y, over the sum of both tensions", "", "",
          "unequal_tension_xy_interval", "prestretch_from"),
    Value("membrane.stiffness_gradient_x", "Stiffness along x", "Relative change of the rubber's "
          "stiffness from the middle to the rim, in x", "", "", "stiffness_gradient_x_interval",
          "prestretch_from"),
    Value("membrane.stiffness_gradient_y", "Stiffness along y", "Relative change of the rubber's "
          "stiffness from the middle to the rim, in y", "", "", "stiffness_gradient_y_interval",
          "prestretch_from"),
    Value("membrane.stiffness_gradient_r", "Stiffness at rim", "Relative change of the rubber's "
          "stiffness from the mean to the rim", "", "", "stiffness_gradient_r_interval",
          "prestretch_from"),
    Value("pneumatics.atmospheric_pressure_pa", "Atmosphere", "Absolute air pressure outside",
          "Pa", "gas_pressure"),
    Value("pneumatics.chamber_volume_m3", "Chamber volume", "Gas volume behind the rim plane",
          "m³", "volume"),
    Value("camera.noise_relative", "Depth noise", "Standard deviation of a pixel's range",
          "of the range", "range_share"),
    Value("camera.colour_delay_s", "Colour delay", "Time stamp of a colour image minus that of "
          "the depth image of the same moment; negative if colour leads depth", "s", "time"),
)  # fmt: skip
"""In the order of the panel."""


def identified_text(sensor: Sensor) -> str:
    """When a sensor was identified, and whether its values were edited since."""
    calibration = sensor.calibration
    if calibration is None:
        return "never; nominal values"
    date = calibration.date
    when = f"{date[:16].replace('T', ' ')} UTC" if date else "date unknown"
    return f"{when}, edited since" if calibration.edited else when


# Row of the panel: a number with its interval, or a box to edit it.

BOX_WIDTH = 70  # px


class ValueRow(QWidget):
    """Shows one number of a sensor in the displayed unit; edits it in the unit of the file."""

    def __init__(self, value: Value, units: Units) -> None:
        super().__init__()
        self.value, self._units = value, units
        # interval: placed in a row of its own
        self.shown, self.unit, self.interval = QLabel(), QLabel(value.si), QLabel()
        self.box = QLineEdit()
        self.box.setMinimumWidth(BOX_WIDTH)
        theme.bold(self.shown)
        theme.dim(self.interval)
        for widget in (self, self.box):
            widget.setToolTip(value.tip)
        fill(QHBoxLayout(self), self.shown, (self.box, 1), self.unit, margins=(0, 0, 0, 0))

    def show_value(self, sensor: Sensor, *, editing: bool) -> None:
        """Show the number of a sensor, or a box to edit it."""
        value, known = self.value, sensor.calibration
        unit = getattr(self._units, value.unit) if value.unit else DIMENSIONLESS
        number = attrgetter(value.key)(sensor)
        ends = getattr(known, value.interval, None) if value.interval else None
        origin = getattr(known, value.source_key, None) if value.source_key else None
        self.shown.setText(NOT_IN_FILE if number is None else unit.text(number).rstrip())
        self.interval.setText("" if ends is None else unit.between(*ends).rstrip())
        self.interval.setToolTip(f"from {origin}" if origin else "")
        if not editing:
            self.box.setText("" if number is None else str(number))
        for widget in (self.box, self.unit):
            widget.setVisible(editing)
        self.shown.setVisible(not editing)

    def read(self) -> float | str | None:
        """The number in the box, SI; invalid text is returned unchanged."""
        text = self.box.text()
        try:
            return float(text) if text.strip() else None
        except ValueError:
            return text


class SensorPanel(QWidget):
    """Values of the sensor in use."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._opening = state, controller.opening
        self._copied: Sensor | None = None  # original of the copy being edited
        self.name, self.file = QLineEdit(), QLineEdit(readOnly=True)
        self.camera, self.identified, self.difference = QLabel(), QLabel(), QLabel()
        self.recording = QLineEdit(readOnly=True)
        self.rows = {value.key: ValueRow(value, state.units) for value in VALUES}
        self.problem = QLabel(wordWrap=True)
        self.edit = push_button(
            "Edit a copy…",
            "Edit the values and save them as a new sensor file; this file is not changed",
            self._begin,
        )
        self.reload = push_button("Reload", "Read the sensor file again", self._reload)
        self.save = push_button(
            "Save as…",
            "Write a sensor file, with its mesh and pixels, and use it",
            self._choose_file,
        )
        self.cancel = push_button("Cancel", "Discard the changes", self._end)
        self._watch = SensorWatch(self)
        self._lay_out()
        self._show()
        for box in (self.name, *(row.box for row in self.rows.values())):
            box.textEdited.connect(self._check)
        self._watch.changed.connect(self._on_difference)
        controller.opened.connect(self._on_opened)
        state.follow(UNIT_CHOICES, self._show)

    def _lay_out(self) -> None:
        self.name.setToolTip("Name of the sensor")
        for label in (self.problem, self.difference):
            theme.doubtful(label)
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
        """The original of the copy being edited, else the sensor in use."""
        return self._copied or self._opening.sensor

    def _show(self) -> None:
        sensor, editing = self._sensor, self._copied is not None
        self.problem.hide()
        self.difference.setVisible(bool(self.difference.text()))
        self.name.setReadOnly(not editing)
        recording = (sensor and sensor.calibration and sensor.calibration.recording) or ""
        for label in (self.camera, self.identified):
            self._form.setRowVisible(label, not editing)
        self._form.setRowVisible(self.recording, bool(recording) and not editing)
        self.recording.setText(recording)
        for button, visible in (
            (self.edit, not editing),
            (self.reload, not editing),
            (self.save, editing),
            (self.cancel, editing),
        ):
            button.setVisible(visible)
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
            visible = bool(row.interval.text()) and not editing
            self._form.setRowVisible(row.interval, visible)

    def _show_file(self, sensor: Sensor) -> None:
        path, short = str(sensor.resolve(sensor.file).absolute()), file_text(sensor)
        is_path = short == sensor.file
        self.file.setText(path if is_path else short)
        self.file.setToolTip(
            path if sensor.file else "Not saved yet; save it in Calibration → Report"
        )

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
        """The edited copy; None if invalid, with the reason shown below the boxes."""
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
        if path is None:
            return
        if self._state.messages.report("sensor file", path, partial(save_sensor, copy, path)):
            self._end()
            self._opening.open_sensor_file(path)

    # -- the file -----------------------------------------------------------------------------

    @property
    def _opened_file(self) -> Path:
        sensor = self._opening.sensor
        return Path() if sensor is None else sensor.resolve(sensor.file).absolute()

    def _reload(self) -> None:
        self._opening.open_sensor_file(self._opened_file)

    def _on_opened(self, opened: Opened) -> None:
        self.difference.clear()
        self._watch.watch(opened.sensor)
        if self._copied is None:
            self._show()

    def _on_difference(self, difference: str) -> None:
        self.difference.setText(difference and "The sensor's files were changed or removed")
        self.difference.setToolTip(difference and f"{self._opened_file}: {difference}")
        self.difference.setVisible(bool(difference))
        if difference:
            self._state.messages.add("warning", f"{self._opened_file}: {difference}")


def _proposed(sensor: Sensor) -> str:
    """Proposed path of a copy: next to the user's file, else in the current folder."""
    name = f"{Path(sensor.file or 'sensor').stem}_edited.toml"
    return str(sensor.resolve(name).absolute()) if file_text(sensor) == sensor.file else name
