"""Six numbers for where the object begins."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QDoubleSpinBox, QGridLayout, QLabel, QWidget

from bubbleviz.files.pose_reader import angles_of_pose, pose_of_angles
from bubbleviz_ui.model.units import Units

FARTHEST_M = 0.5  # m from B's origin: beyond any bubble
NAMES = ("x", "y", "z")


class StartBoxes(QWidget):
    """Position and rotation (about fixed x, then y, then z) of O in B.

    Attributes
    ----------
    edited : Signal
        T_B_O (4, 4) as typed.
    """

    edited = Signal(object)

    def __init__(self, units: Units) -> None:
        super().__init__()
        self._units = units
        self.places = [self._box(f"start_{name}") for name in NAMES]
        self.angles = [self._box(f"start_r{name}") for name in NAMES]
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        for column, name in enumerate(NAMES):
            grid.addWidget(QLabel(name), 0, 2 * column)
            grid.addWidget(self.places[column], 0, 2 * column + 1)
            grid.addWidget(QLabel(f"r{name}"), 1, 2 * column)
            grid.addWidget(self.angles[column], 1, 2 * column + 1)
            grid.setColumnStretch(2 * column + 1, 1)
            self.places[column].setToolTip(f"Start of the search: {name} of T_B_O")
            self.angles[column].setToolTip(f"Start of the search: turn about {name} of B, degrees")
        for box in self.angles:
            box.setRange(-180.0, 180.0)
            box.setDecimals(1)
            box.setSuffix("°")
            box.setWrapping(True)
        self.fit_units()

    def fit_units(self) -> None:
        """Take the units chosen now."""
        unit = self._units.length
        for box in self.places:
            with QSignalBlocker(box):
                box.setRange(-unit.of(FARTHEST_M), unit.of(FARTHEST_M))
                box.setDecimals(max(1, unit.digits - 1))
                box.setSingleStep(unit.of(1e-3))
                box.setSuffix(f" {unit.symbol}")

    def show_pose(self, T_B_O: np.ndarray) -> None:
        """Write a pose (4, 4) into the boxes."""
        angles = np.degrees(angles_of_pose(T_B_O))
        place = self._units.length.of(1.0) * T_B_O[:3, 3]
        values = zip([*self.places, *self.angles], [*place, *angles], strict=True)
        for box, value in values:
            with QSignalBlocker(box):
                box.setValue(float(value))

    def pose(self) -> np.ndarray:
        """T_B_O (4, 4) as it is in the boxes."""
        place = np.array([self._units.length.to_si(box.value()) for box in self.places])
        return pose_of_angles(place, np.radians([box.value() for box in self.angles]))

    def _box(self, name: str) -> QDoubleSpinBox:
        box = QDoubleSpinBox()
        box.setObjectName(name)
        box.setButtonSymbols(QDoubleSpinBox.ButtonSymbols.NoButtons)
        box.setKeyboardTracking(False)
        box.setMinimumWidth(46)
        box.valueChanged.connect(lambda _: self.edited.emit(self.pose()))
        return box
