"""Compare panel: two settings of the estimator, measured side by side on the frame one sees."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from PySide6.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QGridLayout,
    QLabel,
    QPushButton,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.diagnostics.side_by_side import Measured
from bubbleviz.inverse.estimator import MAX_NODES, EstimatorOptions
from bubbleviz.inverse.solvers.inverse_solver import ESTIMATORS
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.requests import Compared
from bubbleviz_ui.model.choices import SETTINGS, Setting
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import NOTHING, Units
from bubbleviz_ui.panels.binding import bind, options
from bubbleviz_ui.panels.kappa_panel import HIGHEST
from bubbleviz_ui.panels.keep_keys import keep_keys
from bubbleviz_ui.shell.layouts import fill

NODES, STEP = 5_000, 100
"""Most nodes to choose, below MAX_NODES, and a step."""
BLOCKS = 16
ROWS: dict[str, tuple[str, Callable[[Measured, Units], str]]] = {
    "solver": ("Model", lambda m, u: m.solver),
    "status": ("Status", lambda m, u: m.status),
    "total": ("Total time", lambda m, u: u.duration.text(m.total_ms)),
    "solve": ("Solver time", lambda m, u: u.duration.text(m.solve_ms)),
    "force": ("Force", lambda m, u: u.force.with_interval(m.force_n, m.force_half_width_n)),
    "area": ("Patch area", lambda m, u: u.area.text(m.area_m2)),
    "residual": ("Residual", lambda m, u: u.fine_length.text(m.residual_m)),
    "force_error": ("Force error", lambda m, u: u.share.text(m.force_error)),
    "iou": ("Patch IoU", lambda m, u: NOTHING if math.isnan(m.iou) else f"{m.iou:.2f}"),
    "nodes": ("Nodes used", lambda m, u: f"{m.nodes}"),
}
"""What is measured, by its title and its text."""


class Column:
    """Controls of one setting of the two, and a column of what it makes of the frame."""

    def __init__(self, state: SessionState, number: int) -> None:
        self._state, self._number = state, number
        self.solver = options(QComboBox(), {None: "default", **{name: name for name in ESTIMATORS}})
        self.pressure_scale = QDoubleSpinBox(
            minimum=0.1, maximum=100.0, singleStep=0.5, suffix=" ×"
        )
        self.recasts = QSpinBox(minimum=0, maximum=5)
        self.nodes = QSpinBox(singleStep=STEP)
        self.nodes.setRange(0, min(NODES, MAX_NODES))
        self.nodes.setSpecialValueText("sensor's")
        self.block = QSpinBox(minimum=0, maximum=BLOCKS, suffix=" px")
        self.block.setSpecialValueText("automatic")
        self.kappa = QDoubleSpinBox(minimum=0.0, maximum=HIGHEST, singleStep=0.5)
        self.kappa.setSpecialValueText("as shown")
        self.used = QPushButton(f"Use {SETTINGS[number]}")
        self.used.clicked.connect(self.use)
        self.values = {name: QLabel(NOTHING) for name in ROWS}
        usual = EstimatorOptions()
        self._bind("solver", None)
        self._bind("pressure_scale", usual.pressure_scale)
        self._bind("recasts", usual.relinearisations)
        self._bind("nodes", 0)
        self._bind("block", 0)
        self._bind("kappa", 0.0)
        for label in self.values.values():
            label.setObjectName("value")

    def _bind(self, name: str, usual: Any) -> None:
        """Bind a control to the field of its name; what is usual stands for None."""

        def shown(settings: tuple[Setting, ...]) -> Any:
            value = getattr(settings[self._number], name)
            return usual if value is None else value

        def chosen(value: Any) -> tuple[Setting, ...]:
            settings = list(self._state.choices.compared)
            new = replace(settings[self._number], **{name: None if value == usual else value})
            settings[self._number] = new
            return tuple(settings)

        control = getattr(self, name)
        if isinstance(control, QSpinBox | QDoubleSpinBox):
            control.setKeyboardTracking(False)
        bind(control, self._state, "compared", shown, chosen)

    @property
    def setting(self) -> Setting:
        """What is chosen."""
        return self._state.choices.compared[self._number]

    def use(self) -> None:
        """Have the whole window use it from now on."""
        kappa = self.setting.kappa
        rule = {} if kappa is None else {"kappa": kappa}
        self._state.choose(solver=SETTINGS[self._number], **rule)

    def show_measured(self, measured: Measured | str | None, units: Units) -> None:
        """Write the numbers; a text says why there are none."""
        for name, (_, text) in ROWS.items():
            shown = text(measured, units) if isinstance(measured, Measured) else NOTHING
            self.values[name].setText(shown)
        if isinstance(measured, str):
            self.values["status"].setText("impossible")
        self.values["status"].setToolTip(measured if isinstance(measured, str) else "")


class ComparePanel(QWidget):
    """Two settings A and B; measures whenever the frame or a setting is another.

    What it measures it asks of the solver thread, which does it when nobody waits for a frame.
    """

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self.setObjectName("compare")
        self._state, self._controller = state, controller
        self._answer: Compared | None = None
        self.a, self.b = Column(state, 0), Column(state, 1)
        self._lay_out()
        controller.compared.connect(self._on_compared)
        keep_keys(self)
        state.frame_changed.connect(self._ask)
        state.source_changed.connect(self._ask)
        state.choices_changed.connect(self._on_choices)

    def _lay_out(self) -> None:
        grid = QGridLayout()
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(3)
        for place, title in enumerate(("A", "B"), start=1):
            grid.addWidget(QLabel(title), 0, place)
        controls = {
            "Solver": ("solver", "Of the inverse problem: rubber is the exact membrane"),
            "Pressure prior": (
                "pressure_scale",
                "Contact pressure expected, in gauge pressures: the larger, the less smoothing",
            ),
            "Ray-cast passes": ("recasts", "How often rays are cast again within a frame"),
            "Nodes": ("nodes", "Of the mesh; where the sensor has a mesh file, that counts"),
            "Pixel binning": ("block", "Side of the squares of pixels that are averaged"),
            "κ": ("kappa", "Threshold as a multiple of the mean contact pressure"),
            "": ("used", "Analyse all frames with it; undo brings the present solver back"),
        }
        for row, (title, (name, tip)) in enumerate(controls.items(), start=1):
            grid.addWidget(QLabel(title), row, 0)
            for place, each in enumerate((self.a, self.b), start=1):
                control = getattr(each, name)
                control.setToolTip(tip)
                control.setMinimumWidth(84)
                grid.addWidget(control, row, place)
        for row, (name, (title, _)) in enumerate(ROWS.items(), start=len(controls) + 1):
            grid.addWidget(QLabel(title), row, 0)
            for place, each in enumerate((self.a, self.b), start=1):
                grid.addWidget(each.values[name], row, place)
        grid.setColumnStretch(1, 1)
        grid.setColumnStretch(2, 1)
        self.hint = QLabel("Force error and IoU need a simulation's truth.", wordWrap=True)
        self.hint.setObjectName("dim")
        fill(QVBoxLayout(self), grid, self.hint, 1, margins=(6, 8, 2, 8))

    @property
    def _seen(self) -> bool:
        """Neither closed nor behind another tab, where Qt still calls it visible."""
        return "compare" in self._state.choices.panels

    def _on_choices(self, names: frozenset[str]) -> None:
        if "panels" in names and not self._seen:
            self._forget()
        elif names & {"kappa", "compared"} or self._answer is None:
            self._ask()
        else:
            self._show()

    def _forget(self) -> None:
        """Measure nothing more; old numbers would look like new ones."""
        self._answer = None
        self._controller.compare(())
        self._show()

    def _ask(self) -> None:
        if self._seen and self._state.facts is not None:
            choices = self._state.choices
            rules = [choices.kappa if s.kappa is None else s.kappa for s in choices.compared]
            estimators = [setting.options for setting in choices.compared]
            self._controller.compare(tuple(zip(estimators, rules, strict=True)))

    def _on_compared(self, answer: Compared) -> None:
        if self._seen:
            self._answer = answer
            self._show()

    def _show(self) -> None:
        measured = self._answer.measured if self._answer is not None else (None, None)
        for column, one in zip((self.a, self.b), measured, strict=True):
            column.show_measured(one, self._state.units)
