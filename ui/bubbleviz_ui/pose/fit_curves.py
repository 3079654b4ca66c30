"""Fitness and rmse over the iterations of a fit, and over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from PySide6.QtCore import QEvent
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import QVBoxLayout, QWidget

from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell.theme import BLUE, ORANGE

HEIGHT = 92
LEFT, BOTTOM, HEAD = 42, 18, 17
"""Room for the axes and the text, screen pixels."""


class Curves(QWidget):
    """Two plots below each other: iterations of the last fit, and frames so far."""

    def __init__(self, units: Units) -> None:
        super().__init__()
        import pyqtgraph as pg  # 0.2 s later than the window

        self._units = units
        self._view = pg.GraphicsView(background=None)
        layout = pg.GraphicsLayout()
        layout.setContentsMargins(0, 0, 0, 0)
        self._view.setCentralItem(layout)
        self.iterations, self.frames = _Curve(pg, layout, 0), _Curve(pg, layout, 1)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self._view)
        self.setMinimumHeight(2 * HEIGHT + 2 * HEAD)
        self._paint()

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

    def changeEvent(self, event: QEvent) -> None:
        """Follow the theme."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange:
            self._paint()

    def close_plots(self) -> None:
        """Let go of the graphics view before Qt does."""
        self._view.close()

    def _paint(self) -> None:
        for curve in (self.iterations, self.frames):
            curve.paint(self.palette().color(QPalette.ColorRole.PlaceholderText))


class _Curve:
    """Fitness and rmse on one axis: 1 is all of the patch, and 1 mm.

    Attributes
    ----------
    fitness, rmse : pyqtgraph.PlotDataItem
    """

    def __init__(self, pg: Any, layout: Any, row: int) -> None:
        self.box = pg.ViewBox(enableMenu=False)
        self.box.setMouseEnabled(x=False, y=False)
        self.axes = [pg.AxisItem("left"), pg.AxisItem("bottom")]
        self.words = pg.LabelItem(justify="left", size="9pt")
        layout.addItem(self.words, 3 * row, 1)
        layout.addItem(self.axes[0], 3 * row + 1, 0)
        layout.addItem(self.box, 3 * row + 1, 1)
        layout.addItem(self.axes[1], 3 * row + 2, 1)
        for axis in self.axes:
            axis.linkToView(self.box)
            axis.enableAutoSIPrefix(False)
            axis.setGrid(40)
        self.axes[0].setWidth(LEFT)
        self.axes[1].setHeight(BOTTOM)
        self.fitness = pg.PlotDataItem(pen=pg.mkPen(BLUE, width=1))
        self.rmse = pg.PlotDataItem(pen=pg.mkPen(ORANGE, width=1))
        self.change = pg.InfiniteLine()
        for item in (self.fitness, self.rmse):
            self.box.addItem(item)
        self.box.addItem(self.change, ignoreBounds=True)

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
        self.words.setText(f"{text} {over}" if over else text)

    def paint(self, dim: Any) -> None:
        """Take the theme's colours."""
        for axis in self.axes:
            axis.setPen(dim)
            axis.setTextPen(dim)
        self.change.setPen(dim)
        self.words.setAttr("color", dim.name())
