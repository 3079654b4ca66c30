"""Contact patch panel: where the patch begins, what that makes of it, and who solves."""

from __future__ import annotations

import math

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.inverse.solvers.inverse_solver import SOLVER_NAMES
from bubbleviz.result import Result
from bubbleviz_ui.model.choices import SETTINGS, solver_title
from bubbleviz_ui.model.result_text import doubt_text, force_text
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panels.binding import bind, options
from bubbleviz_ui.panels.control_input import watch_controls
from bubbleviz_ui.shell.layouts import fill

LOWEST, HIGHEST = 0.1, 100.0
STEPS_PER_DECADE = 100
BEFORE = 3.0
"""κ to begin with where the threshold was automatic."""


class KappaPanel(QWidget):
    """Slider (logarithmic) and box for κ; the patch follows without another solve."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.by_kappa = QWidget()
        self.automatic = QCheckBox("Automatic threshold")
        self.automatic.setToolTip(
            "By the physics of contact: each patch must somewhere reach the gas pressure.\n"
            "Untick it to draw the patch where the contact pressure p_c exceeds κ times its mean"
            " (section V-C of the paper)"
        )
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(
            *(round(STEPS_PER_DECADE * math.log10(end)) for end in (LOWEST, HIGHEST))
        )
        self.slider.setPageStep(10)
        self.slider.setToolTip(
            "κ: threshold as a multiple of the mean contact pressure (section V-C of the paper)"
        )
        self.box = QDoubleSpinBox(minimum=LOWEST, maximum=HIGHEST, decimals=2, prefix="κ = ")
        self.box.setToolTip(self.slider.toolTip())
        self.box.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        self.box.setKeyboardTracking(False)
        self.solver = options(
            QComboBox(),
            {name: solver_title(name) for name in (None, *SOLVER_NAMES, *SETTINGS)},
        )
        self.solver.setToolTip("Solver of the inverse problem (Eq. 23); changing it starts anew")
        self.threshold, self.area, self.by_object, self.force = (_value() for _ in range(4))
        self.by_object.setToolTip("Patch by the object at its pose: the green outline")
        self.doubt = QLabel(wordWrap=True)
        self.doubt.setObjectName("doubt")
        self._lay_out()
        self.show_result(None)
        self._bind(state)
        watch_controls(self)

    def _lay_out(self) -> None:
        fill(QHBoxLayout(self.by_kappa), (self.slider, 1), self.box, margins=(0, 0, 0, 0))
        self._form = form = QFormLayout()
        form.setHorizontalSpacing(16)
        form.addRow("Threshold", self.threshold)
        form.addRow("Patch area", self.area)
        form.addRow("By the object", self.by_object)
        form.addRow("Force", self.force)
        form.addRow("Solver", self.solver)
        fill(
            QVBoxLayout(self),
            self.automatic,
            self.by_kappa,
            form,
            self.doubt,
            1,
            margins=(12, 10, 12, 12),
        )

    def _bind(self, state: SessionState) -> None:
        bind(self.solver, state, "solver")
        bind(self.automatic, state, "kappa", lambda kappa: kappa is None, self._automatic)
        self._kappa = (
            bind(self.slider, state, "kappa", _to_steps, _to_kappa),
            bind(self.box, state, "kappa"),
        )
        state.choices_changed.connect(self._show_rule)
        self._show_rule()
        if state.choices.kappa is None:
            for each in self._kappa:
                each.show(BEFORE)

    def _automatic(self, on: bool) -> float | None:
        return None if on else self.box.value()

    def _show_rule(self, names: frozenset[str] = frozenset({"kappa"})) -> None:
        """One rule draws the outline, and only its controls are there."""
        if "kappa" in names:
            self.by_kappa.setVisible(self._state.choices.kappa is not None)

    def show_result(self, result: Result | None) -> None:
        """Write the numbers of the patch; none without a result."""
        units, patch = self._state.units, None if result is None else result.trusted_patch
        threshold_pa = patch.threshold_pa if patch else None
        automatic = self._state.choices.kappa is None
        self.threshold.setText("automatic" if automatic else units.pressure.text(threshold_pa))
        area = (patch.area_m2, *patch.area_interval_m2) if patch else (math.nan,) * 3
        self.area.setText(units.area.with_range(*area))
        found = None if result is None else result.object_patch
        self.by_object.setText("" if found is None else units.area.text(found.area_m2))
        self._form.setRowVisible(self.by_object, found is not None)
        self.force.setText(units.force.text(None) if result is None else force_text(result, units))
        self.doubt.setText("" if result is None else doubt_text(result))
        self.doubt.setVisible(bool(self.doubt.text()))


def _value() -> QLabel:
    label = QLabel()
    label.setObjectName("value")
    return label


def _to_steps(kappa: float | None) -> int | None:
    return None if kappa is None else round(STEPS_PER_DECADE * math.log10(kappa))


def _to_kappa(steps: int) -> float:
    return round(10.0 ** (steps / STEPS_PER_DECADE), 2)
