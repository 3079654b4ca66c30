"""The tangential force and its 95 % region, seen along z of the bubble frame."""

from __future__ import annotations

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz.diagnostics.shear_numbers import ShearEllipse
from bubbleviz_ui.model.units import Unit
from bubbleviz_ui.panels.plot_frame import PlotFrame
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.shell.theme import BLUE

HEIGHT = 170
"""Screen pixels."""


class ShearPlot(PlotHost):
    """An arrow's line from no force to the tangential force, and an ellipse around its end.

    Attributes
    ----------
    force, outline : pyqtgraph.PlotDataItem
    """

    def __init__(self) -> None:
        super().__init__(self._fill)
        self.setFixedHeight(HEIGHT)
        self.setToolTip("Tangential force along x and y of the bubble frame, with its 95 % region")

    def _fill(self) -> list[Part]:
        import pyqtgraph as pg  # 0.2 s later than the window

        self._frame = PlotFrame("number")
        self._frame.box.setMouseEnabled(x=False, y=False)
        self._frame.box.setAspectLocked(True)
        self.force = pg.PlotDataItem(pen=pg.mkPen(BLUE, width=2))
        self.outline = pg.PlotDataItem(pen=pg.mkPen(BLUE, width=1))
        for item in (self.force, self.outline):
            self._frame.box.addItem(item)
        self.arrange([self._frame.item])
        return [self]

    def draw(self, ellipse: ShearEllipse | None, unit: Unit) -> None:
        """Draw it in a unit of force, or nothing."""
        if not self.ready:
            return
        self._frame.write(f"Tangential y over x, {unit.symbol}")
        for item, points in (
            (self.force, None if ellipse is None else np.vstack([np.zeros(2), ellipse.force_n])),
            (self.outline, None if ellipse is None else ellipse.outline_n),
        ):
            item.setData(unit.of(1.0) * (np.empty((0, 2)) if points is None else points))

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self._frame.paint(dim, text)
