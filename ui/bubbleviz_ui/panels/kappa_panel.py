"""Contact patch panel: threshold κ, resulting patch area and force, choice of the solver."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QPointF
from PySide6.QtWidgets import QCheckBox, QDoubleSpinBox, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from bubbleviz.diagnostics import KappaCurve
from bubbleviz.inverse import Component
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PATCH_SETTINGS, Settings
from bubbleviz_ui.model.source_facts import NO_RESULT, force_text, untrusted_text
from bubbleviz_ui.model.units import DASH, UNIT_CHOICES, Units
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.panels.time_plot import FramePlot
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import Binding, SliderBox, control, form
from bubbleviz_ui.shell.dock import fill
from bubbleviz_ui.shell.table import Table
from bubbleviz_ui.shell.theme import BLUE, ORANGE

INITIAL_KAPPA = 3.0
"""First κ offered after the automatic threshold."""


class KappaPanel(QWidget):
    """Logarithmic slider and box for κ; the patch is updated without solving again."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.automatic = QCheckBox("Automatic threshold")
        self.automatic.setToolTip(
            "Ticked: the patch is the part under contact pressure; its edge follows from gas "
            "pressure and camera resolution.\nUnticked: it is where the contact pressure p_c "
            "exceeds κ times its mean over the membrane (section V-C of the paper)"
        )
        info = Settings.info("kappa")
        self.box = QDoubleSpinBox(minimum=info.low, maximum=info.high, decimals=2, prefix="κ = ")
        self.box.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        self.box.setValue(INITIAL_KAPPA)
        self.by_kappa = SliderBox(self.box, info.tip, logarithmic=True)
        self.solver = control(state, "solver")
        self.numbers = tuple(theme.bold(QLabel()) for _ in range(4))
        self.threshold, self.area, self.by_object, self.force = self.numbers
        self.area.setToolTip(
            "Area on the membrane at rest; in brackets the areas inside the two thin lines, the "
            "smallest and the largest patch that noise allows"
        )
        self.by_object.setToolTip("Area of the patch by the object at its pose (green outline)")
        self.doubt = theme.doubtful(QLabel(wordWrap=True))
        self._lay_out()
        self.show_result(NO_RESULT)
        Binding(self.automatic, state, "kappa", lambda kappa: kappa is None, self._automatic)
        Binding(self.by_kappa, state, "kappa")
        state.follow({"kappa"}, self._show_kappa_controls)
        self._show_kappa_controls()

    def _lay_out(self) -> None:
        self._form = form(
            ("Threshold", self.threshold),
            ("Patch area", self.area),
            ("By the object", self.by_object),
            ("Force", self.force),
            self.solver,
        )
        self._form.setHorizontalSpacing(16)
        parts = self.automatic, self.by_kappa, self._form, self.doubt
        fill(QVBoxLayout(self), *parts, 1, margins=(12, 10, 12, 12))

    def _automatic(self, on: bool) -> float | None:
        return None if on else self.box.value()

    def _show_kappa_controls(self) -> None:
        """Show the controls of κ unless the threshold is automatic."""
        self.by_kappa.setVisible(self._state.settings.kappa is not None)

    def show_result(self, result: Result) -> None:
        """Show the numbers of the patch; dashes without one."""
        units, patch = self._state.units, result.trusted_patch
        threshold_pa = patch.threshold_pa if patch else None
        automatic = self._state.settings.kappa is None
        self.threshold.setText("automatic" if automatic else units.pressure.text(threshold_pa))
        area = (patch.area_m2, *patch.area_interval_m2) if patch else (math.nan,) * 3
        self.area.setText(units.area.with_range(*area))
        found = result.object_patch
        self.by_object.setText("" if found is None else units.area.text(found.area_m2))
        self._form.setRowVisible(self.by_object, found is not None)
        self.force.setText(force_text(result, units, final=self._state.final))
        self.doubt.setText(untrusted_text(result))
        self.doubt.setVisible(bool(self.doubt.text()))


# Plots over κ with the threshold as a draggable line.


class KappaAxisPlot(FramePlot):
    """A plot of the frame shown over log10 κ, with the threshold as a line to drag."""

    def __init__(self, state: SessionState, controller: Controller, line_width: int = 1) -> None:
        super().__init__("logarithm")
        self._state, self._controller = state, controller
        self._drawn: Result | None = None
        self.line = self.add_line(bright=True, width=line_width, movable=True)  # At log10 κ
        self.line.sigPositionChangeFinished.connect(self._on_dragged)

    def draw(self, _: object = None) -> None:
        """Move the line to κ without emitting its signals; hide it if κ is automatic."""
        kappa, self._drawn = self._state.settings.kappa, self._controller.result
        self.line.setVisible(kappa is not None)
        if kappa is not None:
            self.line.blockSignals(True)
            self.line.setValue(math.log10(kappa))
            self.line.blockSignals(False)

    def show_cursor(self, _: int, __: int | None) -> None:
        """Draw the frame that is shown, unless only the mouse has moved."""
        if self._controller.result is not self._drawn:
            self.draw()

    def frame_at(self, _: QPointF) -> int | None:
        """None: there is one frame only."""
        return None

    def _on_dragged(self, line: Any) -> None:
        self._state.change(kappa=round(10.0 ** line.value(), 2))


class KappaHistogram(KappaAxisPlot):
    """Histogram of membrane area over contact pressure, as a multiple of its mean."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__(state, controller, line_width=2)
        self.bars = pg.BarGraphItem(x=[0.0], height=[0.0], width=0.05, brush=BLUE, pen=None)
        self.box.addItem(self.bars)

    def draw(self, _: object = None) -> None:
        """Draw the histogram of the frame shown, and the line."""
        super().draw()
        curve, units = self._controller.inspection.kappa_curve, self._state.units
        if curve is None:
            self.bars.setOpts(x=[0.0], height=[0.0], width=0.05)
        else:
            edges = np.log10(curve.kappa)
            self.bars.setOpts(
                x=0.5 * (edges[1:] + edges[:-1]),
                height=units.area.from_si(1.0) * curve.histogram_m2,
                width=0.9 * (edges[1] - edges[0]),
            )
        self.write(f"Area ({units.area.symbol}) by p_c / mean p_c")


class KappaPlot(KappaAxisPlot):
    """Patch area of the frame over κ; also the IoU if the ground truth is known."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__(state, controller)
        self.curve, self.iou = self.add_curve(BLUE), self.add_curve(ORANGE)

    def draw(self, _: object = None) -> None:
        """Draw the curve of the frame shown, and the line."""
        super().draw()
        curve, units = self._controller.inspection.kappa_curve, self._state.units
        self.curve.setData([], [])
        self.iou.setData([], [])
        if curve is not None:
            area = units.area.from_si(1.0) * curve.area_m2
            self.curve.setData(np.log10(curve.kappa), area)
            if curve.iou is not None:  # scaled to the areas, as both share the axis
                self.iou.setData(np.log10(curve.kappa), float(area.max()) * curve.iou)
        text = _heading(curve, self._controller.result, self._state.settings.kappa, units)
        if curve is not None and curve.iou is not None:
            best = int(np.argmax(curve.iou))
            text += (
                f' · <span style="color:{ORANGE}">κ {curve.kappa[best]:.1f}: best IoU '
                f"{curve.iou[best]:.2f}</span>"  # κ first: the end may be cut off
            )
        self.write(text)


def _heading(curve: KappaCurve | None, result: Result, kappa: float | None, units: Units) -> str:
    """Area at κ and what remains of it without small parts, or the automatic area."""
    patch = result.trusted_patch
    area_m2 = None if patch is None else patch.area_m2
    if kappa is None:
        return f"auto {units.area.text(area_m2)}"
    total_m2 = None if curve is None else curve.area_at(kappa)
    if area_m2 is not None and total_m2 is not None and area_m2 < 0.98 * total_m2:
        remaining = units.area.text(area_m2).split()[0]
        return f"{remaining} of {units.area.text(total_m2)} kept"
    return f"{units.area.text(total_m2)} at κ"


# Threshold panel: pressure histogram, κ-curve and parts of the patch.

HEIGHT = 300
"""Height of both plots, screen pixels."""
COLUMNS = ("Area", "Force", "Peak pressure", "")
FORCE_TIP = (
    "Force: magnitude of the force on the part, friction included; the force vectors of all parts, "
    "removed ones included, add up to the force of the frame"
)


class ThresholdPanel(QWidget):
    """Histogram and κ-curve with the threshold as a line, and a table of the patch's parts."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._controller = state, controller
        self._host = PlotHost(self._make)
        self._host.setMinimumHeight(HEIGHT)
        self._host.seen.connect(self._draw)
        self.table = Table(COLUMNS, len(COLUMNS) - 1)
        self.least = control(state, "least_area_m2")
        self._lay_out()
        controller.shown.connect(self._draw)
        state.follow({*PATCH_SETTINGS, *UNIT_CHOICES}, self._draw)

    def _lay_out(self) -> None:
        row = fill(QHBoxLayout(), QLabel(self.least.accessibleName()), (self.least, 1))
        self.table.horizontalHeader().setToolTip(FORCE_TIP)
        self.table.setMinimumHeight(96)
        parts = (self._host, 2), row, (self.table, 1)
        fill(QVBoxLayout(self), *parts, margins=(8, 6, 8, 8), spacing=6)

    def _make(self) -> list[Part]:
        shared = self._state, self._controller
        self.histogram, self.curve = KappaHistogram(*shared), KappaPlot(*shared)
        self._host.arrange([self.histogram.item, self.curve.item])
        self.curve.box.setXLink(self.histogram.box)
        return [self.histogram, self.curve]

    def _draw(self) -> None:
        if self._host.ready:
            self.histogram.draw()
            self.curve.draw()
            self._fill(self._controller.inspection.components)

    def _fill(self, parts: tuple[Component, ...]) -> None:
        units, least = self._state.units, self._state.settings.least_area_m2
        self.table.setRowCount(len(parts) or 1)
        self.table.write(0, (DASH, "", "", ""), right=range(0))
        for row, part in enumerate(parts):
            removed = part.area_m2 < least
            texts = (
                units.area.text(part.area_m2),
                units.force.text(part.force_magnitude_n),
                units.pressure.text(part.peak_pa),
                "removed" if removed else "contact",
            )
            self.table.write(row, texts, right=range(0), dim=removed)
