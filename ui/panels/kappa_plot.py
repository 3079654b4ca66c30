"""The κ-curve: what another threshold would make of the frame that is shown."""

from __future__ import annotations

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz.inverse.kappa_curve import KappaCurve
from bubbleviz.result import Result
from ui.panels.kappa_histogram import put_line
from ui.panels.plot_frame import PlotFrame
from ui.theme import BLUE, ORANGE
from ui.units import Units


class KappaPlot:
    """Patch area over κ, with κ as a line to drag; in a simulation the IoU, too.

    Attributes
    ----------
    line : pyqtgraph.InfiniteLine
        At log10 κ; can be dragged.
    """

    def __init__(self) -> None:
        import pyqtgraph as pg

        self.frame = PlotFrame(seconds=False)
        self.box = self.frame.box
        self.box.setMouseEnabled(x=False, y=False)
        self.curve = pg.PlotDataItem(pen=pg.mkPen(BLUE, width=1))
        self.iou = pg.PlotDataItem(pen=pg.mkPen(ORANGE, width=1))
        self.line = pg.InfiniteLine(movable=True)
        for item in (self.curve, self.iou):
            self.box.addItem(item)
        self.box.addItem(self.line, ignoreBounds=True)

    def draw(
        self,
        curve: KappaCurve | None,
        result: Result | None,
        kappa: float | None,
        units: Units,
        at: float | None = None,
    ) -> None:
        """Draw the curve of a frame; nothing without one. The line is at κ, or at `at`."""
        self.curve.setData([], [])
        self.iou.setData([], [])
        if curve is not None:
            area = units.area.of(1.0) * curve.area_m2
            self.curve.setData(np.log10(curve.kappa), area)
            if curve.iou is not None:  # as high as the areas: the two share the axis
                self.iou.setData(np.log10(curve.kappa), float(area.max()) * curve.iou)
        put_line(self.line, at if kappa is None else kappa)
        area_m2 = result.patch.area_m2 if result is not None and result.patch else None
        text = f"{units.area.text(area_m2)} over κ"
        if curve is not None and curve.iou is not None:
            best = int(np.argmax(curve.iou))
            text += (
                f' · <span style="color:{ORANGE}">IoU ≤ {curve.iou[best]:.2f}'
                f" at {curve.kappa[best]:.1f}</span>"
            )
        self.frame.write(text)

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.frame.paint(dim, text)
        self.line.setPen(text)
