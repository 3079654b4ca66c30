"""A number of the sensor file with its interval, or a box to type another one."""

from __future__ import annotations

from PySide6.QtWidgets import QHBoxLayout, QLabel, QLineEdit, QWidget

from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.sensor.sensor_text import Value
from bubbleviz_ui.shell.layouts import fill

BOX_WIDTH = 70  # px: less than ten digits, more scroll


class ValueRow(QWidget):
    """Shows one number of a sensor in the operator's unit; edits it in the file's.

    Attributes
    ----------
    interval : QLabel
        The 95 % interval, for a row of its own.
    """

    def __init__(self, value: Value, units: Units) -> None:
        super().__init__()
        self.value, self._units = value, units
        self.shown, self.unit, self.interval = QLabel(), QLabel(value.si), QLabel()
        self.box = QLineEdit()
        self.box.setMinimumWidth(BOX_WIDTH)
        self.shown.setObjectName("value")
        self.interval.setObjectName("dim")
        for widget in (self, self.box):
            widget.setToolTip(value.tip)
        fill(QHBoxLayout(self), self.shown, (self.box, 1), self.unit, margins=(0, 0, 0, 0))

    def show_value(self, sensor: Sensor, *, editing: bool) -> None:
        """Show the number of a sensor, or offer it to be edited."""
        self.shown.setText(self.value.text(sensor, self._units))
        self.interval.setText(self.value.interval_text(sensor, self._units))
        self.interval.setToolTip(self.value.origin(sensor))
        if not editing:
            self.box.setText(self.value.written(sensor))
        for widget in (self.box, self.unit):
            widget.setVisible(editing)
        self.shown.setVisible(not editing)

    def read(self) -> float | str | None:
        """The number in the box, SI; what is none, as it was typed."""
        return self.value.read(self.box.text())
