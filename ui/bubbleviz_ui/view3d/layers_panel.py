"""Layers panel: what is drawn, in which colours and on which scale."""

from __future__ import annotations

from PySide6.QtCore import Qt
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

from bubbleviz_ui.model.registry import LAYERS, LayerKind
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panels.binding import bind, bind_member, bind_quantity, options, watch_controls
from bubbleviz_ui.shell.dock import fill

CLOUD_POINTS = {
    5_000: "up to 5 000",
    10_000: "up to 10 000",
    20_000: "up to 20 000",
    50_000: "up to 50 000",
    None: "all",
}
CLOUD_COLOURS = {"residual": "residual", "patch": "patch", "plain": "one colour"}


HIGHEST_PA, LARGEST_M, STEP = 1e6, 0.1, 1e-3
"""Ends of the boxes for ranges, and a step as a share of them."""


class LayersPanel(QWidget):
    """Check boxes for the layers and the choices that belong to them."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.boxes = {name: self._box(name, kind) for name, kind in LAYERS.items()}
        self.cloud_colour = options(QComboBox(), CLOUD_COLOURS)
        self.cloud_points = options(QComboBox(), CLOUD_POINTS)
        self.opacity = QSlider(Qt.Orientation.Horizontal)
        self.opacity.setRange(10, 100)
        self.pressure_max, self.residual_max = _range_box(), _range_box()
        self._lay_out()
        self._bind(state)
        self._enable()
        watch_controls(self)
        state.choices_changed.connect(self._enable)

    def _box(self, name: str, kind: LayerKind) -> QCheckBox:
        box = QCheckBox(kind.title)
        box.setObjectName(f"layer_{name}")
        box.setToolTip(kind.tip)
        return box

    def _lay_out(self) -> None:
        line = QFrame()
        line.setObjectName("line")
        line.setFixedHeight(1)
        form = QFormLayout()
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.addRow("Colour points by", self.cloud_colour)
        form.addRow("Points shown", self.cloud_points)
        form.addRow("Opacity", self.opacity)
        form.addRow("Maximum pressure", self.pressure_max)
        form.addRow("Maximum residual ±", self.residual_max)
        fill(QVBoxLayout(self), *self.boxes.values(), line, form, margins=(6, 10, 2, 10), spacing=5)
        self.cloud_colour.setToolTip("Residual: measured minus modelled range; patch: in it or not")
        self.cloud_points.setToolTip(
            "Beyond that every n-th point is drawn; all are solved with. Without a GPU a quarter "
            "of them is drawn while frames follow each other"
        )
        self.opacity.setToolTip("Opacity of the membrane, 10 … 100 %")
        self.pressure_max.setToolTip("Pressure that has the last colour; lowest value: automatic")
        self.residual_max.setToolTip(
            "Residual that has the first or last colour; lowest value: automatic"
        )

    def _bind(self, state: SessionState) -> None:
        for name, box in self.boxes.items():
            bind_member(box, state, "layers", name)
        bind(self.cloud_colour, state, "cloud_colour")
        bind(self.cloud_points, state, "cloud_points")
        bind(self.opacity, state, "membrane_opacity", lambda v: round(100 * v), lambda v: v / 100)
        most = HIGHEST_PA
        bind_quantity(
            self.pressure_max, state, "pressure_max_pa", lambda u: u.pressure, most, most * STEP
        )
        most = LARGEST_M
        bind_quantity(
            self.residual_max, state, "residual_max_m", lambda u: u.length, most, most * STEP
        )

    def _enable(self) -> None:
        """Let only what belongs to a visible layer be changed."""
        choices = self._state.choices
        membrane, cloud = "membrane" in choices.layers, "cloud" in choices.layers
        self.opacity.setEnabled(membrane)
        self.pressure_max.setEnabled(membrane)
        self.cloud_colour.setEnabled(cloud)
        self.cloud_points.setEnabled(cloud)
        self.residual_max.setEnabled(cloud and choices.cloud_colour == "residual")


def _range_box() -> QDoubleSpinBox:
    box = QDoubleSpinBox()
    box.setSpecialValueText("automatic")
    return box
