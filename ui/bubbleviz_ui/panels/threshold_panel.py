"""Threshold panel: where κ cuts the pressure, what that costs, and which parts are too small."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import Qt
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import (
    QAbstractItemView,
    QDoubleSpinBox,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.patch.components import Component
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import NOTHING
from bubbleviz_ui.panels.binding import bind_quantity
from bubbleviz_ui.panels.control_input import watch_controls
from bubbleviz_ui.panels.kappa_plots import KappaHistogram, KappaPlot, kappa_at
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.shell.layouts import fill

ROW = 20
"""Height of a row of the table, screen pixels."""
HEIGHT = 300
"""Of both plots, screen pixels."""
LARGEST_M2, STEP_M2 = 0.01, 5e-6  # m²: any bubble; 5 mm²
COLUMNS = ("Area", "Force", "Peak pressure", "")
TIPS = {
    "Force": "Length of the force on the part, friction included; as vectors, the forces of all"
    " parts, removed ones too, add up to the force of the frame"
}


class ThresholdPanel(QWidget):
    """Histogram and κ-curve with the threshold as a line, and a table of the patch's parts."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self.setObjectName("threshold")
        self._state, self._controller = state, controller
        self._host = PlotHost(self._make)
        self._host.setMinimumHeight(HEIGHT)
        self._host.seen.connect(self._draw)
        self.histogram: KappaHistogram | None = None
        self.curve: KappaPlot | None = None
        self.table = QTableWidget(0, len(COLUMNS))
        self.least = QDoubleSpinBox()
        self.least.setSpecialValueText("nothing")
        self.least.setToolTip("Parts of the patch smaller than this are not contact")
        self._lay_out()
        bind_quantity(
            self.least, state, "least_area_m2", lambda u: u.area, LARGEST_M2, STEP_M2, zero=0.0
        )
        controller.shown.connect(self._draw)
        watch_controls(self)
        state.choices_changed.connect(self._draw)

    def _lay_out(self) -> None:
        row = fill(QHBoxLayout(), QLabel("Remove parts below"), (self.least, 1))
        table = self.table
        for column, title in enumerate(COLUMNS):
            header = QTableWidgetItem(title)
            header.setToolTip(TIPS.get(title, ""))
            table.setHorizontalHeaderItem(column, header)
        table.verticalHeader().hide()
        table.verticalHeader().setDefaultSectionSize(ROW)
        table.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        table.horizontalHeader().setStretchLastSection(True)
        table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        table.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        table.setMinimumHeight(96)
        fill(QVBoxLayout(self), (self._host, 2), row, (table, 1), margins=(8, 6, 8, 8), spacing=6)

    def _make(self) -> list[Part]:
        self.histogram, self.curve = KappaHistogram(), KappaPlot()
        self._host.arrange([self.histogram.frame.item, self.curve.frame.item])
        self.curve.box.setXLink(self.histogram.box)
        for plot in (self.histogram, self.curve):
            plot.line.sigPositionChangeFinished.connect(self._on_dragged)
        return [self.histogram, self.curve]

    # -- events -------------------------------------------------------------------------------

    def _on_dragged(self, line: Any) -> None:
        self._state.choose(kappa=kappa_at(line))

    # -- drawing ------------------------------------------------------------------------------

    def _draw(self) -> None:
        if not self._host.ready:
            return
        result, inspection = self._controller.result, self._controller.inspection
        units = self._state.units
        kappa = self._state.choices.kappa
        if self.histogram is not None and self.curve is not None:
            self.histogram.draw(inspection.kappa_curve, kappa, units)
            self.curve.draw(inspection.kappa_curve, result, kappa, units)
        self._fill(inspection.components)

    def _fill(self, parts: tuple[Component, ...]) -> None:
        units, least = self._state.units, self._state.choices.least_area_m2
        self.table.setRowCount(len(parts))
        for row, part in enumerate(parts):
            texts = (
                units.area.text(part.area_m2),
                units.force.text(part.force_magnitude_n),
                units.pressure.text(part.peak_pa),
                "contact" if part.area_m2 >= least else "removed",
            )
            for column, text in enumerate(texts):
                item = QTableWidgetItem(text)
                if part.area_m2 < least:
                    item.setForeground(self.palette().color(QPalette.ColorRole.PlaceholderText))
                self.table.setItem(row, column, item)
        if not parts:
            self.table.setRowCount(1)
            self.table.setItem(0, 0, QTableWidgetItem(NOTHING))
