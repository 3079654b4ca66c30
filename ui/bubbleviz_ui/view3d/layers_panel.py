"""Layers panel: what is drawn, in which colours and on which scale."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QFrame,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from bubbleviz_ui.model.choices import LAYERS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import Unit
from bubbleviz_ui.panels.keep_keys import keep_keys

TITLES = {
    "membrane": ("Membrane", "Deformed membrane, coloured by contact pressure p_c"),
    "wireframe": ("Wireframe", "Edges of the membrane's mesh"),
    "contour": ("Patch contour", "Where the contact pressure crosses the κ threshold"),
    "cloud": ("Measured points", "Depth image as points in the bubble frame"),
    "force": ("Force arrow", "Resultant of the contact pressure, at the centre of pressure"),
    "readout": ("Readout", "Force, peak pressure and patch area, in the view"),
    "frustum": ("Camera frustum", "Field of view of the depth camera"),
    "rim": ("Rim", "Where the membrane is clamped"),
    "object": ("Object", "The object that is looked for, at its pose"),
    "fit": ("Fit", "Contact points by distance from the object, and what is not determined"),
    "vectors": ("Pressure vectors", "Contact pressure p_c at each node, along its normal"),
}
CLOUD_POINTS = {
    5_000: "up to 5 000",
    10_000: "up to 10 000",
    20_000: "up to 20 000",
    50_000: "up to 50 000",
    None: "all",
}
CLOUD_COLOURS = {"residual": "residual", "patch": "patch membership", "plain": "one colour"}


HIGHEST_PA, LARGEST_M, STEP = 1e6, 0.1, 1e-3
"""Ends of the boxes for ranges, and a step as a share of them."""


class LayersPanel(QWidget):
    """Check boxes for the layers and the choices that belong to them."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.boxes = {name: self._box(name) for name in LAYERS}
        self.cloud_colour = QComboBox()
        for value, title in CLOUD_COLOURS.items():
            self.cloud_colour.addItem(title, value)
        self.cloud_points = QComboBox()
        for most, title in CLOUD_POINTS.items():
            self.cloud_points.addItem(title, most)
        self.opacity = QSlider(Qt.Orientation.Horizontal)
        self.opacity.setRange(10, 100)
        self.pressure_max, self.residual_max = _range_box(), _range_box()
        self._lay_out()
        self._show_choices()
        self._connect()
        keep_keys(self)
        state.choices_changed.connect(self._show_choices)

    def _box(self, name: str) -> QCheckBox:
        title, tip = TITLES[name]
        box = QCheckBox(title)
        box.setObjectName(f"layer_{name}")
        box.setToolTip(tip)
        return box

    def _lay_out(self) -> None:
        column = QVBoxLayout(self)
        column.setContentsMargins(12, 10, 12, 10)
        column.setSpacing(5)
        for box in self.boxes.values():
            column.addWidget(box)
        line = QFrame()
        line.setObjectName("line")
        line.setFixedHeight(1)
        column.addWidget(line)
        form = QFormLayout()
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.addRow("Points by", self.cloud_colour)
        form.addRow("Points shown", self.cloud_points)
        form.addRow("Opacity", self.opacity)
        form.addRow("Pressure to", self.pressure_max)
        form.addRow("Residual to ±", self.residual_max)
        column.addLayout(form)
        self.cloud_colour.setToolTip("What colours the points; residual: measured minus modelled")
        self.cloud_points.setToolTip("Beyond that every n-th point is drawn; all are solved with")
        self.opacity.setToolTip("Opacity of the membrane, 10 … 100 %")
        self.pressure_max.setToolTip("Upper end of the pressure colours; lowest value: automatic")
        self.residual_max.setToolTip("Ends of the residual colours; lowest value: automatic")

    def _connect(self) -> None:
        state = self._state
        for name, box in self.boxes.items():
            box.toggled.connect(lambda on, name=name: state.choose_layer(name, on))
        self.cloud_colour.currentIndexChanged.connect(
            lambda _: state.choose(cloud_colour=self.cloud_colour.currentData())
        )
        self.cloud_points.currentIndexChanged.connect(
            lambda _: state.choose(cloud_points=self.cloud_points.currentData())
        )
        self.opacity.valueChanged.connect(lambda v: state.choose(membrane_opacity=v / 100))
        units = state.units
        self.pressure_max.valueChanged.connect(
            lambda v: state.choose(pressure_max_pa=units.pressure.to_si(v) if v > 0 else None)
        )
        self.residual_max.valueChanged.connect(
            lambda v: state.choose(residual_max_m=units.length.to_si(v) if v > 0 else None)
        )

    def _show_choices(self) -> None:
        choices = self._state.choices
        for name, box in self.boxes.items():
            box.setChecked(name in choices.layers)
        self.cloud_colour.setCurrentIndex(self.cloud_colour.findData(choices.cloud_colour))
        self.cloud_points.setCurrentIndex(self.cloud_points.findData(choices.cloud_points))
        self.cloud_points.setEnabled("cloud" in choices.layers)
        self.opacity.setValue(round(100 * choices.membrane_opacity))
        self.cloud_colour.setEnabled("cloud" in choices.layers)
        self.opacity.setEnabled("membrane" in choices.layers)
        units = self._state.units
        _show_range(self.pressure_max, choices.pressure_max_pa, units.pressure, HIGHEST_PA)
        _show_range(self.residual_max, choices.residual_max_m, units.length, LARGEST_M)
        self.pressure_max.setEnabled("membrane" in choices.layers)
        by_residual = choices.cloud_colour == "residual"
        self.residual_max.setEnabled("cloud" in choices.layers and by_residual)


def _range_box() -> QDoubleSpinBox:
    box = QDoubleSpinBox()
    box.setSpecialValueText("automatic")
    box.setKeyboardTracking(False)
    return box


def _show_range(box: QDoubleSpinBox, value_si: float | None, unit: Unit, most_si: float) -> None:
    """Show the end of a range in a unit; automatic without one."""
    with QSignalBlocker(box):
        box.setDecimals(unit.digits)
        box.setRange(0.0, unit.of(most_si))
        box.setSingleStep(unit.of(most_si) * STEP)
        box.setSuffix(f" {unit.symbol}")
        box.setValue(unit.of(value_si) if value_si is not None else 0.0)
