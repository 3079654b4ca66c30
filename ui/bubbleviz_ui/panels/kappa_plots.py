"""Plots over κ with the threshold as a line to drag: areas of pressure, and of the patch.

pyqtgraph is imported with the first plot: the window starts 0.2 s earlier.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz.diagnostics.kappa_curve import KappaCurve
from bubbleviz.result import Result
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.plot_frame import PlotFrame
from bubbleviz_ui.shell.theme import BLUE, ORANGE


class OverKappa:
    """A plot over log10 κ.

    Attributes
    ----------
    frame : PlotFrame
    box : pyqtgraph.ViewBox
    line : pyqtgraph.InfiniteLine
        At log10 κ; can be dragged.
    """

    def __init__(self, line_width: int = 1) -> None:
        import pyqtgraph as pg

        self.frame = PlotFrame("logarithm")
        self.box = self.frame.box
        self.box.setMouseEnabled(x=False, y=False)
        self.line = pg.InfiniteLine(movable=True)
        self.box.addItem(self.line, ignoreBounds=True)
        self._line_width = line_width

    def put_line(self, kappa: float | None) -> None:
        """Put the line at κ without telling it was moved; away without κ."""
        self.line.setVisible(kappa is not None)
        if kappa is not None:
            self.line.blockSignals(True)
            self.line.setValue(math.log10(kappa))
            self.line.blockSignals(False)

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.frame.paint(dim, text)
        self.line.setPen(text, width=self._line_width)


def kappa_at(line: Any) -> float:
    """κ at which a line was put down."""
    return round(float(10.0 ** line.value()), 2)


class KappaHistogram(OverKappa):
    """Area of the membrane by its contact pressure, in multiples of the mean one.

    Attributes
    ----------
    bars : pyqtgraph.BarGraphItem
    """

    def __init__(self) -> None:
        import pyqtgraph as pg

        super().__init__(line_width=2)
        self.bars = pg.BarGraphItem(x=[0.0], height=[0.0], width=0.05, brush=BLUE, pen=None)
        self.box.addItem(self.bars)

    def draw(self, curve: KappaCurve | None, kappa: float | None, units: Units) -> None:
        """Draw the histogram of a frame and the line at κ; none while that is automatic."""
        if curve is None:
            self.bars.setOpts(x=[0.0], height=[0.0], width=0.05)
        else:
            edges = np.log10(curve.kappa)
            self.bars.setOpts(
                x=0.5 * (edges[1:] + edges[:-1]),
                height=units.area.of(1.0) * curve.histogram_m2,
                width=0.9 * (edges[1] - edges[0]),
            )
        self.put_line(kappa)
        self.frame.write(f"Area by p_c / mean p_c ({units.area.symbol})")


class KappaPlot(OverKappa):
    """Patch area that another κ would make of the frame; in a simulation the IoU, too.

    Attributes
    ----------
    curve, iou : pyqtgraph.PlotDataItem
    """

    def __init__(self) -> None:
        import pyqtgraph as pg

        super().__init__()
        self.curve = pg.PlotDataItem(pen=pg.mkPen(BLUE, width=1))
        self.iou = pg.PlotDataItem(pen=pg.mkPen(ORANGE, width=1))
        for item in (self.curve, self.iou):
            self.box.addItem(item)

    def draw(
        self, curve: KappaCurve | None, result: Result | None, kappa: float | None, units: Units
    ) -> None:
        """Draw the curve of a frame and the line at κ; none while that is automatic."""
        self.curve.setData([], [])
        self.iou.setData([], [])
        if curve is not None:
            area = units.area.of(1.0) * curve.area_m2
            self.curve.setData(np.log10(curve.kappa), area)
            if curve.iou is not None:  # as high as the areas: the two share the axis
                self.iou.setData(np.log10(curve.kappa), float(area.max()) * curve.iou)
        self.put_line(kappa)
        text = _heading(curve, result, kappa, units)
        if curve is not None and curve.iou is not None:
            best = int(np.argmax(curve.iou))
            text += (
                f' · <span style="color:{ORANGE}">IoU ≤ {curve.iou[best]:.2f}'
                f" at {curve.kappa[best]:.1f}</span>"
            )
        self.frame.write(text)


def _heading(
    curve: KappaCurve | None, result: Result | None, kappa: float | None, units: Units
) -> str:
    """The curve's area at κ and what is kept of it without small parts; or the automatic area."""
    patch = None if result is None else result.trusted_patch
    area_m2 = None if patch is None else patch.area_m2
    if kappa is None:
        return f"auto {units.area.text(area_m2)}"
    whole_m2 = None if curve is None else curve.area_at(kappa)
    if area_m2 is not None and whole_m2 is not None and area_m2 < 0.98 * whole_m2:
        kept = units.area.text(area_m2).split()[0]
        return f"{kept} of {units.area.text(whole_m2)}"
    return f"{units.area.text(whole_m2)} at κ"
