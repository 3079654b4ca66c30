"""Layers panel: visible layers, their colours and scales."""

from __future__ import annotations

from PySide6.QtGui import QPalette
from PySide6.QtWidgets import QCheckBox, QFormLayout, QFrame, QVBoxLayout, QWidget

from bubbleviz_ui.model.registry import LAYERS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.shell.binding import bind_membership, control, form
from bubbleviz_ui.shell.dock import fill


class LayersPanel(QWidget):
    """Check boxes of the layers, and their settings."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.boxes = {name: QCheckBox(kind.title) for name, kind in LAYERS.items()}
        self.cloud_colour = control(state, "cloud_colour")
        self.cloud_points = control(state, "cloud_points")
        self.opacity = control(state, "membrane_opacity")
        self.pressure_max = control(state, "pressure_max_pa")
        self.residual_max = control(state, "residual_max_m")
        line = QFrame()
        line.setFrameStyle(QFrame.Shape.HLine | QFrame.Shadow.Plain)
        line.setForegroundRole(QPalette.ColorRole.PlaceholderText)
        rows = form(
            self.cloud_colour, self.cloud_points, self.opacity, self.pressure_max, self.residual_max
        )
        rows.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        fill(QVBoxLayout(self), *self.boxes.values(), line, rows, margins=(6, 10, 2, 10), spacing=5)
        for name, box in self.boxes.items():
            box.setToolTip(LAYERS[name].tip)
            bind_membership(box, state, "layers", name)
        self._enable()
        state.settings_changed.connect(self._enable)

    def _enable(self) -> None:
        """Enable the settings of visible layers."""
        settings = self._state.settings
        membrane, cloud = "membrane" in settings.layers, "cloud" in settings.layers
        self.opacity.setEnabled(membrane)
        self.pressure_max.setEnabled(membrane)
        self.cloud_colour.setEnabled(cloud)
        self.cloud_points.setEnabled(cloud)
        self.residual_max.setEnabled(cloud and settings.cloud_colour == "residual")
