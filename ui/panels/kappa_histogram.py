"""Histogram of the contact pressure over κ, with the threshold as a line to drag."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz.inverse.kappa_curve import KappaCurve
from ui.panels.plot_frame import PlotFrame
from ui.theme import BLUE
from ui.units import Units


class KappaHistogram:
    """Area of the membrane by its pressure, in multiples of the mean pressure.

    Attributes
    ----------
    line : pyqtgraph.InfiniteLine
        At log10 κ; can be dragged.
    """

    def __init__(self) -> None:
        import pyqtgraph as pg

        self.frame = PlotFrame(seconds=False)
        self.frame.box.setMouseEnabled(x=False, y=False)
        self.bars = pg.BarGraphItem(x=[0.0], height=[0.0], width=0.05, brush=BLUE, pen=None)
        self.line = pg.InfiniteLine(movable=True)
        self.frame.box.addItem(self.bars)
        self.frame.box.addItem(self.line, ignoreBounds=True)

    def draw(self, curve: KappaCurve | None, kappa: float | None, units: Units) -> None:
        """Draw the histogram of a frame and the line at κ; nothing without them."""
        if curve is None:
            self.bars.setOpts(x=[0.0], height=[0.0], width=0.05)
        else:
            edges = np.log10(curve.kappa)
            self.bars.setOpts(
                x=0.5 * (edges[1:] + edges[:-1]),
                height=units.area.of(1.0) * curve.histogram_m2,
                width=0.9 * (edges[1] - edges[0]),
            )
        put_line(self.line, kappa)
        self.frame.write(f"Area by p_c / mean p_c ({units.area.symbol})")

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.frame.paint(dim, text)
        self.line.setPen(text, width=2)


def put_line(line: Any, kappa: float | None) -> None:
    """Put a line at log10 κ without telling it was moved; away without κ."""
    line.setVisible(kappa is not None)
    if kappa is not None:
        line.blockSignals(True)
        line.setValue(math.log10(kappa))
        line.blockSignals(False)
