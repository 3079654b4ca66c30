"""What belongs to a folder of depth images: camera, times, unit, and what was measured beside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtWidgets import QComboBox, QDoubleSpinBox, QFormLayout

from bubbleviz_ui.importing.file_field import FileField
from bubbleviz_ui.panels.binding import options

UNITS = {
    None: "whole numbers mm, others m",
    1.0: "m",
    1e-3: "mm",
    2.5e-4: "0.25 mm",
    1e-4: "0.1 mm",
    1e-6: "µm",
}
"""Metres that a pixel's value of 1 stands for; None: by its kind."""
BY_ITSELF, RATE, TABLE = "times.csv in the folder, else the names", "a rate", "a table"
TABLES = "Tables (*.csv);;All files (*)"


class ImageFields:
    """The options of `bubbleviz convert` for a folder of images.

    Parameters
    ----------
    form : QFormLayout
        Gets a row for each.
    changed : callable
        Called when something else is chosen.
    """

    def __init__(self, form: QFormLayout, changed: Callable[[], None]) -> None:
        self.intrinsics = FileField(
            "Intrinsics: a TOML or JSON file, or a sensor file",
            "Intrinsics (*.toml *.json);;All files (*)",
            "intrinsics.toml or .json in the folder, else the sensor file's",
        )
        self.unit = options(QComboBox(), UNITS)
        self.unit.setToolTip("What a pixel's value of 1 stands for")
        self.timing = QComboBox()
        self.timing.addItems([BY_ITSELF, RATE, TABLE])
        self.timing.setToolTip("Where the times of the images come from")
        self.rate = QDoubleSpinBox(minimum=0.01, maximum=1e4, value=30.0, suffix=" Hz")
        self.rate.setToolTip("Images a second")
        self.times = FileField("A time in s for each image", TABLES)
        self.gas_pressure = FileField(
            "Gas pressure: time in s, absolute pressure in Pa", TABLES, "not measured"
        )
        self.wrench = FileField(
            "Wrench: time in s, forces x y z in N, torques in N·m", TABLES, "not measured"
        )
        self._form, self._shown = form, False
        self._rows: dict[str, FileField | QComboBox | QDoubleSpinBox] = {
            "Intrinsics": self.intrinsics,
            "Unit": self.unit,
            "Times": self.timing,
            "Rate": self.rate,
            "Table of times": self.times,
            "Gas pressure": self.gas_pressure,
            "Wrench": self.wrench,
        }
        for title, field in self._rows.items():
            form.addRow(title, field)
        self.timing.currentIndexChanged.connect(lambda _: self.show(self._shown))
        for field in self._rows.values():
            if isinstance(field, FileField):
                field.changed.connect(changed)
            elif isinstance(field, QComboBox):
                field.currentIndexChanged.connect(lambda _: changed())
            else:
                field.valueChanged.connect(lambda _: changed())

    @property
    def beside(self) -> dict[str, Any]:
        """What is chosen, by the options of `bubbleviz.convert`."""
        timing = self.timing.currentText()
        return {
            "intrinsics": self.intrinsics.path,
            "times": self.times.path if timing == TABLE else None,
            "gas_pressure": self.gas_pressure.path,
            "wrench": self.wrench.path,
            "rate_hz": self.rate.value() if timing == RATE else None,
            "metres_per_unit": self.unit.currentData(),
        }

    def show(self, shown: bool, *, enabled: bool = True) -> None:
        """Show the rows that apply, or none."""
        self._shown, timing = shown, self.timing.currentText()
        for field in self._rows.values():
            apart = (field is self.rate and timing != RATE) or (
                field is self.times and timing != TABLE
            )
            self._form.setRowVisible(field, shown and not apart)
            field.setEnabled(enabled)
