"""Fitness and rmse over the iterations of a fit, and over time."""

from __future__ import annotations

from typing import Literal

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.panels.plot_frame import PlotFrame
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.panels.time_plot import alone
from bubbleviz_ui.shell.theme import BLUE, ORANGE

Below = Literal["number", "seconds"]
HEIGHT = 109
"""Of a plot with its text, screen pixels."""


class Curves(PlotHost):
    """Fitness and rmse side by side: of the iterations of the fit, and of the frames so far.

    Attributes
    ----------
    iterations, frames : (Curve, Curve)
        Fitness, and rmse in the operator's unit of length.
    """

    def __init__(self, units: Units) -> None:
        super().__init__(self._fill)
        self._units = units
        self.setMinimumHeight(2 * HEIGHT)
        self.setToolTip("Above: iterations of the fit, both stages; below: frames so far")
        self.prepare()

    def _fill(self) -> list[Part]:
        self.iterations, self.frames = _pair("number"), _pair("seconds")
        every = [*self.iterations, *self.frames]
        self.arrange([curve.frame.item for curve in every], columns=2)
        return list(every)

    def draw_iterations(self, one: np.ndarray, two: np.ndarray) -> None:
        """Histories (i, 2) of the stages, one after the other."""
        both = np.concatenate([one, two])
        self._draw(self.iterations, np.arange(len(both)), both, len(one))

    def draw_frames(self, numbers: np.ndarray, time_s: np.ndarray, values: np.ndarray) -> None:
        """Fitness, and rmse in m, (f, 2) of frames by their numbers; no line across others."""
        breaks = np.flatnonzero(np.diff(numbers) > 1) + 1
        times = np.insert(time_s, breaks, time_s[breaks])
        self._draw(self.frames, times, np.insert(values, breaks, np.nan, axis=0), None)

    def clear_iterations(self) -> None:
        """Draw none: the pose was not fitted."""
        self._draw(self.iterations, np.zeros(0), np.zeros((0, 2)), None)

    def clear(self) -> None:
        """Draw nothing."""
        self.clear_iterations()
        self._draw(self.frames, np.zeros(0), np.zeros((0, 2)), None)

    def _draw(
        self, curves: tuple[Curve, Curve], x: np.ndarray, values: np.ndarray, change: int | None
    ) -> None:
        for k, unit in enumerate((self._units.share, self._units.length)):
            curves[k].draw(x, values[:, k], unit, change)


def _pair(below: Below) -> tuple[Curve, Curve]:
    return Curve("fitness", BLUE, below, top=1.0), Curve("rmse", ORANGE, below)


class Curve:
    """One quantity in its unit, from 0; its last value is above, a dash where there is none.

    Parameters
    ----------
    name, colour : str
    below : {"number", "seconds"}
        What the axis below has.
    top : float, optional
        Where the axis ends, SI; at the largest value where not given.

    Attributes
    ----------
    line : pyqtgraph.PlotDataItem
    """

    def __init__(self, name: str, colour: str, below: Below, top: float | None = None) -> None:
        import pyqtgraph as pg  # 0.2 s later than the window

        self._name, self._colour, self._top = name, colour, top
        self.frame = PlotFrame(below)
        self.frame.box.setMouseEnabled(x=False, y=False)
        self.line = pg.PlotDataItem(
            pen=pg.mkPen(colour, width=1), connect="finite",
            symbolSize=4, symbolBrush=colour, symbolPen=None,
        )  # fmt: skip
        self.change = pg.InfiniteLine()
        self.frame.box.addItem(self.line)
        self.frame.box.addItem(self.change, ignoreBounds=True)

    def draw(self, x: np.ndarray, values: np.ndarray, unit: Unit, change: int | None) -> None:
        """Draw values (k,) in SI, NaN for none, with a line where the second stage begins."""
        symbol = "o" if alone(values).any() else None
        self.line.setData(x, unit.of(1.0) * values, symbol=symbol)
        top = self._top or float(np.nanmax(values, initial=0.0))
        if top > 0.0:
            self.frame.box.setYRange(0.0, unit.of(top), padding=0.05)
        self.change.setVisible(change is not None)
        if change is not None:
            self.change.setValue(change - 0.5)
        last = f" {unit.text(float(values[-1]))}" if len(values) else ""
        self.frame.write(f'<span style="color:{self._colour}">{self._name}{last}</span>')

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.frame.paint(dim, dim)
        self.change.setPen(dim)
