"""One plot over time: its quantities, their curves, the cursor and the numbers there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz_ui.model.frame_history import History, thinned
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.panels.plot_frame import PlotFrame
from bubbleviz_ui.shell.theme import BLUE, GREEN, ORANGE


@dataclass(frozen=True)
class Trace:
    """What a plot shows.

    Attributes
    ----------
    title : str
    unit : callable
        Its unit among the operator's.
    curves : dict
        Colour by quantity of the history.
    words : tuple of str
        What the curves are called; empty for a single one.
    """

    title: str
    unit: Callable[[Units], Unit]
    curves: dict[str, str]
    words: tuple[str, ...] = ("",)


TRACES = MappingProxyType(
    {
        "force": Trace("Force", lambda u: u.force, {"force_n": BLUE}),
        "gas": Trace(
            "p_v",
            lambda u: u.gas_pressure,
            {"gas_law_pa": BLUE, "gas_measured_pa": ORANGE},
            ("estimated", "measured"),
        ),
        "area": Trace("Patch area", lambda u: u.area, {"area_m2": BLUE}),
        "center": Trace(
            "Centre of pressure",
            lambda u: u.length,
            {"center_x_m": ORANGE, "center_y_m": GREEN, "center_z_m": BLUE},
            ("x", "y", "z"),
        ),
        "residual": Trace("Residual rms", lambda u: u.fine_length, {"residual_m": BLUE}),
        "solve": Trace(
            "Run time",
            lambda u: u.duration,
            {"solve_ms": BLUE, "total_ms": ORANGE},
            ("solver", "in → out"),
        ),
        "latency": Trace("Latency", lambda u: u.duration, {"latency_ms": BLUE}),
    }
)
"""Plots over time by name."""


class TimePlot:
    """Curves of some quantities over time.

    Parameters
    ----------
    trace : Trace

    Attributes
    ----------
    cursor : pyqtgraph.InfiniteLine
        Can be dragged.
    """

    def __init__(self, trace: Trace) -> None:
        import pyqtgraph as pg  # 0.2 s later than the window

        self.trace = trace
        self._history: History | None = None
        self.frame = PlotFrame("seconds")
        self.box = self.frame.box
        self.box.setMouseEnabled(x=True, y=False)
        self.box.enableAutoRange(y=True)
        self.box.setAutoVisible(y=True)
        self.curves = {
            name: pg.PlotDataItem(pen=pg.mkPen(colour, width=1), connect="finite", symbolSize=4)
            for name, colour in trace.curves.items()
        }
        self.cursor = pg.InfiniteLine(movable=True)
        for curve in self.curves.values():
            self.box.addItem(curve)
        self.box.addItem(self.cursor, ignoreBounds=True)

    def draw(self, times_s: np.ndarray, history: History, units: Units) -> None:
        """Draw what is known, in the operator's unit."""
        self._history = history
        scale = self.trace.unit(units).of(1.0)
        for name, curve in self.curves.items():
            low, high = self.box.viewRange()[0]
            times, values = thinned(times_s, history.values[name], (low, high))
            curve.setData(
                times,
                values * scale,
                symbol="o" if _alone(values) else None,
                symbolBrush=self.trace.curves[name],
                symbolPen=None,
            )

    def show_all(self, times_s: np.ndarray) -> None:
        """Show all of time."""
        end = float(times_s[-1])
        self.box.setXRange(float(times_s[0]), end if end > times_s[0] else 1.0, padding=0.01)

    def show_last(self, now_s: float, seconds: float) -> None:
        """Show the time before a moment."""
        self.box.setXRange(max(now_s - seconds, 0.0), max(now_s, 1.0), padding=0.0)

    def show_cursor(self, frame: int, time_s: float, units: Units) -> None:
        """Put the cursor on a frame and write its numbers."""
        self.cursor.blockSignals(True)
        self.cursor.setValue(time_s)
        self.cursor.blockSignals(False)
        unit = self.trace.unit(units)
        numbers = zip(self.trace.curves.items(), self.trace.words, strict=True)
        parts = []
        for (name, colour), word in numbers:
            value = float(self._history.values[name][frame]) if self._history else None
            number = unit.text(value).removesuffix(unit.symbol).strip()
            parts.append(f'<span style="color:{colour}">{f"{word} {number}".strip()}</span>')
        self.frame.write(f"{self.trace.title}: {' · '.join(parts)} {unit.symbol}")

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.frame.paint(dim, text)
        self.cursor.setPen(text)

    @property
    def data(self) -> dict[str, tuple[Any, Any]]:
        """Times in s and values in the operator's unit of each curve, as drawn."""
        return {name: curve.getOriginalDataset() for name, curve in self.curves.items()}


def _alone(values: np.ndarray) -> bool:
    """Whether lines would hide frames whose neighbours are not known."""
    known = np.isfinite(values)
    count = int(np.count_nonzero(known))
    return count > 0 and int(np.count_nonzero(known[1:] & known[:-1])) < 0.5 * count
