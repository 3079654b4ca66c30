"""Fitness and rmse over the iterations of a fit, and over time."""

from __future__ import annotations

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.plot_frame import PlotFrame
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.shell.theme import BLUE, ORANGE

HEIGHT = 109
"""Of a plot with its text, screen pixels."""


class Curves(PlotHost):
    """Two plots below each other: iterations of the last fit, and frames so far."""

    def __init__(self, units: Units) -> None:
        super().__init__(self._fill)
        self._units = units
        self.setMinimumHeight(2 * HEIGHT)
        self.prepare()

    def _fill(self) -> list[Part]:
        self.iterations, self.frames = _Curve(), _Curve()
        self.arrange([self.iterations.frame.item, self.frames.frame.item])
        return [self.iterations, self.frames]

    def draw_iterations(self, one: np.ndarray, two: np.ndarray) -> None:
        """Histories (i, 2) of the stages, one after the other."""
        both = np.concatenate([one, two])
        self.iterations.draw(np.arange(len(both)), both, self._units, "by iteration", len(one))

    def draw_frames(self, time_s: np.ndarray, values: np.ndarray) -> None:
        """Fitness, and rmse in m, (f, 2) of frames."""
        self.frames.draw(time_s, values, self._units, "over s", None)

    def clear(self) -> None:
        """Draw nothing."""
        for curve in (self.iterations, self.frames):
            curve.draw(np.zeros(0), np.zeros((0, 2)), self._units, "", None)


class _Curve:
    """Fitness and rmse on one axis: 1 is all of the patch, and 1 mm.

    Attributes
    ----------
    fitness, rmse : pyqtgraph.PlotDataItem
    """

    def __init__(self) -> None:
        import pyqtgraph as pg  # 0.2 s later than the window

        self.frame = PlotFrame("number")
        self.frame.box.setMouseEnabled(x=False, y=False)
        self.fitness = pg.PlotDataItem(pen=pg.mkPen(BLUE, width=1))
        self.rmse = pg.PlotDataItem(pen=pg.mkPen(ORANGE, width=1))
        self.change = pg.InfiniteLine()
        for item in (self.fitness, self.rmse):
            self.frame.box.addItem(item)
        self.frame.box.addItem(self.change, ignoreBounds=True)

    def draw(
        self, x: np.ndarray, values: np.ndarray, units: Units, over: str, change: int | None
    ) -> None:
        """Draw fitness, 1 = 100 %, and rmse, 1 = 1 mm; the last of them is written above."""
        known = np.isfinite(values).all(axis=1)
        x, values = x[known], values[known]
        self.fitness.setData(x, values[:, 0])
        self.rmse.setData(x, 1e3 * values[:, 1])
        self.change.setVisible(change is not None)
        if change is not None:
            self.change.setValue(change - 0.5)
        text = f'<span style="color:{BLUE}">fitness</span>'
        if len(values):
            last = units.length.text(float(values[-1, 1]))
            text += f' <span style="color:{BLUE}">{100 * values[-1, 0]:.0f} %</span> · '
            text += f'<span style="color:{ORANGE}">rmse {last}</span>'
        self.frame.write(f"{text} {over}" if over else text)

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.frame.paint(dim, dim)
        self.change.setPen(dim)
