"""Shear panel: what shear is measured against, how, and the numbers of the frame."""

from __future__ import annotations

from PySide6.QtCore import QTimer
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.diagnostics.shear_numbers import ShearEllipse
from bubbleviz.membrane.rubber_model.friction_forward import MOST_FRICTION
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import NOTHING, SYSTEMS
from bubbleviz_ui.panels.binding import bind, options
from bubbleviz_ui.panels.control_input import watch_controls
from bubbleviz_ui.shear.shear_plot import ShearPlot
from bubbleviz_ui.shear.shear_text import NUMBERS, TIPS, copied_shear, shear_words
from bubbleviz_ui.shell.layouts import fill

EVERY_MS = 150
"""Numbers are written this often: nobody reads faster."""
LOOKING = "Looking for contact-free colour images…"
PRESETS = {"fast": "fast", "balanced": "balanced", "fine": "fine"}
MU, LEAST = 0.5, 0.01
"""Friction bound to begin with, and the least."""


class ShearPanel(QWidget):
    """Settings of the traction with friction, and its numbers with their 95 % intervals."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._controller = state, controller
        self.reference = QLabel(NOTHING, wordWrap=True)
        self.reference.setToolTip("Contact-free colour images that motion is measured from")
        self.collect = QPushButton("Collect again")
        self.collect.setToolTip("Find the contact-free colour images anew; do not touch meanwhile")
        self.flow = options(QComboBox(), PRESETS)
        self.flow.setToolTip("Optical flow: fast, or with less error")
        self.bounded = QCheckBox("Friction bound")
        self.bounded.setToolTip("Keep the tangential below μ times the normal traction (Coulomb)")
        self.friction = QDoubleSpinBox(
            minimum=LEAST, maximum=MOST_FRICTION, decimals=2, singleStep=0.05, prefix="μ = "
        )
        self.friction.setToolTip(self.bounded.toolTip())
        self.friction.setKeyboardTracking(False)
        self.state = QLabel(NOTHING, wordWrap=True)
        self.values = {name: QLabel(NOTHING, wordWrap=True) for name in NUMBERS}
        for name, label in self.values.items():
            label.setObjectName("value")
            label.setToolTip(f"{TIPS[name]}; ± is half of its 95 % interval")
        self.plot = ShearPlot()
        self.plot.seen.connect(self._later)
        self.copy = QPushButton("Copy")
        self.copy.setToolTip("These numbers as text, with their units")
        self._lay_out()
        self._connect(state, controller)
        watch_controls(self)

    def _lay_out(self) -> None:
        numbers, settings = QFormLayout(), QFormLayout()
        for name, title in NUMBERS.items():
            numbers.addRow(title, self.values[name])
        settings.addRow("Optical flow", self.flow)
        settings.addRow(self.bounded, self.friction)
        for form in (numbers, settings):
            form.setHorizontalSpacing(16)
        fill(
            QVBoxLayout(self),
            self.state,
            numbers,
            fill(QHBoxLayout(), QLabel("±: 95 % interval"), 1, self.copy),
            self.plot,
            settings,
            self.reference,
            fill(QHBoxLayout(), self.collect, 1),
            1,
            margins=(12, 10, 12, 12),
        )

    def _connect(self, state: SessionState, controller: Controller) -> None:
        bind(self.flow, state, "flow_preset")
        bind(self.bounded, state, "friction", lambda mu: mu is not None, self._bound)
        self._mu = bind(self.friction, state, "friction")
        if state.choices.friction is None:
            self._mu.show(MU)
        self._due = QTimer(self, singleShot=True, interval=EVERY_MS)
        self._due.timeout.connect(self._write)
        self.collect.clicked.connect(controller.collect)
        self.copy.clicked.connect(self._copy)
        controller.shown.connect(self._later)
        state.choices_changed.connect(self._on_choices)
        self._on_choices(frozenset({"friction"}))

    def _bound(self, on: bool) -> float | None:
        return self.friction.value() if on else None

    def _on_choices(self, names: frozenset[str]) -> None:
        if "friction" in names:
            self.friction.setEnabled(self._state.choices.friction is not None)
        if names & (SYSTEMS.keys() | {"panels"}):
            self._later()

    def _later(self) -> None:
        if "shear" in self._state.choices.panels and not self._due.isActive():
            self._due.start()

    def _write(self) -> None:
        result = self._controller.result
        words = shear_words(result, self._state.units)
        self.reference.setText(self._controller.inspection.reference or LOOKING)
        self.state.setText(words["state"])
        for name, label in self.values.items():
            label.setText(words[name])
        traction = None if result is None else result.traction
        self.copy.setEnabled(traction is not None)
        ellipse = None if traction is None else ShearEllipse.of(traction)
        self.plot.draw(ellipse, self._state.units.force)

    def _copy(self) -> None:
        result = self._controller.result
        if result is not None and result.traction is not None:
            QGuiApplication.clipboard().setText(copied_shear(result, self._state.units))
