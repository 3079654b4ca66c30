"""Plots of the plots panel; one over time: curves, confidence bands, cursor and values."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainterPath
from PySide6.QtWidgets import QGraphicsPathItem

from bubbleviz_ui.model.frame_history import MEASURED_FORCE, UNTRUSTED, decimated
from bubbleviz_ui.model.registry import PLOTS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.panels.plot_host import Plot
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.theme import BLUE, GREEN, ORANGE

if TYPE_CHECKING:
    from bubbleviz_ui.panels.other_recording import AlignedRun

LIVE_WINDOW_S, AHEAD_S = 20.0, 0.2
"""Time span shown of a live source, and room for the cursor until the next redraw."""


class FramePlot(Plot):
    """A plot that is drawn from the frames: in the plots panel, or in the one of the threshold."""

    def show_all(self) -> None:
        """Show the full range of the time axis, if there is one."""

    def draw(self, other: AlignedRun | None = None) -> None:
        """Draw what is known, in the chosen units, and the curves of another recording, if any."""
        raise NotImplementedError

    def show_cursor(self, frame: int, pointed: int | None) -> None:
        """Show the frame at the cursor; `pointed`: the one under the mouse."""
        raise NotImplementedError

    def frame_at(self, place: QPointF) -> int | None:
        """Frame at a position of the canvas, else None."""
        raise NotImplementedError


@dataclass(frozen=True)
class Trace:
    """Contents of a plot over time."""

    name: str  # Of `registry.PLOTS`
    unit: Callable[[Units], Unit]
    curves: dict[str, str]  # Colour by quantity of the history
    labels: tuple[str, ...] = ("",)  # Of the curves; empty for a single one
    # Quantity with half the 95 % interval, drawn as a band, by quantity
    bands: Mapping[str, str] = field(default_factory=dict)
    short: str = ""  # Title in the heading, if the full one is too long

    @property
    def titles(self) -> dict[str, str]:
        """Full title of each quantity."""
        title, named = PLOTS[self.name].title, zip(self.curves, self.labels, strict=True)
        return {name: f"{title}, {word}" if word else title for name, word in named}


_TRACES = (
    Trace(
        "force",
        lambda u: u.force,
        {"force_n": BLUE, MEASURED_FORCE: ORANGE},
        ("", "wrench"),
        {"force_n": "force_half_width_n"},
    ),
    Trace(
        "gas",
        lambda u: u.gas_pressure,
        {"gas_law_pa": BLUE, "gas_measured_pa": ORANGE},
        ("gas law", "measured"),
        short="p_v",
    ),
    Trace("area", lambda u: u.area, {"area_m2": BLUE}),
    Trace(
        "center",
        lambda u: u.length,
        {"center_x_m": ORANGE, "center_y_m": GREEN, "center_z_m": BLUE},
        ("x", "y", "z"),
        short="Centre",
    ),
    Trace("residual", lambda u: u.fine_length, {"residual_m": BLUE}),
    Trace(
        "solve", lambda u: u.duration, {"solve_ms": BLUE, "total_ms": ORANGE}, ("solver", "total")
    ),
    Trace(
        "shear",
        lambda u: u.force,
        {"shear_normal_n": ORANGE, "shear_tangential_n": BLUE},
        ("normal", "tangential"),
        {"shear_tangential_n": "shear_tangential_half_n"},
        short="Shear",
    ),
    Trace("slip", lambda u: u.share, {"slip_share": BLUE}),
    Trace("latency", lambda u: u.duration, {"latency_ms": BLUE}),
)
TRACES = {trace.name: trace for trace in _TRACES}
"""Plots over time by name."""


class TimePlot(FramePlot):
    """Curves of some quantities over time."""

    def __init__(self, trace: Trace, state: SessionState) -> None:
        super().__init__("seconds", mouse="x")
        self.trace, self._state = trace, state
        self.box.enableAutoRange(y=True)
        self.box.setAutoVisible(y=True)
        # bands, curves, dots: By quantity; dots of isolated frames, which no line shows
        self.bands = {name: Band(self, trace.curves[name]) for name in trace.bands}
        self.curves = {name: self.add_curve(colour) for name, colour in trace.curves.items()}
        self.dots = {name: self.add_dots(4, colour) for name, colour in trace.curves.items()}
        self.cursor = self.add_line(bright=True, movable=True)
        self.other_curves: dict[str, Any] = {}  # Those of another recording, once there is one
        self.show_all()

    def draw(self, other: AlignedRun | None = None) -> None:
        """Draw all known values, and those of another recording dashed."""
        facts, history = self._state.facts, self._state.history
        if facts.grows and not self._state.frozen:
            now_s = float(facts.times_s[-1]) + AHEAD_S
            self.box.setXRange(max(now_s - LIVE_WINDOW_S, 0.0), max(now_s, 1.0), padding=0.0)
        scale = self.trace.unit(self._state.units).from_si(1.0)
        low, high = self.box.viewRange()[0]
        for name, curve in self.curves.items():
            known = history.quantity(name)
            times, values = decimated(facts.times_s, known, (low, high), facts.gaps)
            curve.setData(times, values * scale)
            single = isolated(values)
            self.dots[name].setData(times[single], values[single] * scale)
            if name in self.bands:
                half = history.quantity(self.trace.bands[name])
                self.bands[name].draw(facts, known * scale, half * scale, (low, high))
        for curve in self.other_curves.values():
            curve.clear()
        if other is not None:
            self._draw_other(other, scale, (low, high))

    def _draw_other(self, other: AlignedRun, scale: float, window_s: tuple[float, float]) -> None:
        for name, colour in self.trace.curves.items():
            if name not in self.other_curves:
                self.other_curves[name] = self.add_curve(colour, style=Qt.PenStyle.DashLine)
            times, values = decimated(other.times_s, other.history.quantity(name), window_s)
            self.other_curves[name].setData(times, values * scale)

    def show_all(self) -> None:
        """Show the full time range."""
        first, last = map(float, self._state.facts.times_s[[0, -1]])
        self.box.setXRange(first, last if last > first else 1.0, padding=0.01)

    def show_cursor(self, frame: int, pointed: int | None) -> None:
        """Move the cursor to a frame; show its values, or those of the frame under the mouse."""
        times_s = self._state.facts.times_s
        self.cursor.blockSignals(True)
        self.cursor.setValue(float(times_s[frame]))
        self.cursor.blockSignals(False)
        title = self.trace.short or PLOTS[self.trace.name].title
        if pointed is not None:
            title = f"at {self._state.units.time.text(float(times_s[pointed]))}"
        self.write(f"{title}: {self._numbers(frame if pointed is None else pointed)}")

    def frame_at(self, place: QPointF) -> int | None:
        """Frame at the time of a position of the canvas, else None."""
        inside = self.box.sceneBoundingRect().contains(place)
        return self._state.frame_at(self.box.mapSceneToView(place).x()) if inside else None

    def _numbers(self, frame: int) -> str:
        """Values of all curves at a frame, in their colours, and the unit."""
        unit, parts = self.trace.unit(self._state.units), []
        for (name, colour), word in zip(self.trace.curves.items(), self.trace.labels, strict=True):
            if name == MEASURED_FORCE and math.isnan(self._at(name, frame)):
                continue  # most recordings have no wrench
            band = self.trace.bands.get(name)
            half = None if band is None else self._at(band, frame)
            number = unit.with_interval(self._at(name, frame), half)
            number = number.removesuffix(unit.symbol).strip()
            parts.append(f'<span style="color:{colour}">{f"{word} {number}".strip()}</span>')
        doubt = self._state.history.contact[frame] == UNTRUSTED
        note = f' <span style="color:{theme.UNTRUSTED}">not trusted</span>' if doubt else ""
        return f"{' · '.join(parts)} {unit.symbol}{note}"

    def _at(self, name: str, frame: int) -> float:
        return float(self._state.history.quantity(name)[frame])


class Band:
    """The 95 % interval around a curve."""

    def __init__(self, plot: Plot, colour: str) -> None:
        shade = QColor(colour)
        shade.setAlpha(70)
        self.low, self.high = (plot.add_curve(shade) for _ in range(2))
        # FillBetweenItem would fill gaps next to an isolated frame
        self.fill = QGraphicsPathItem()
        self.fill.setBrush(shade)
        self.fill.setPen(Qt.PenStyle.NoPen)
        plot.box.addItem(self.fill)

    def draw(
        self,
        facts: SourceFacts,
        values: np.ndarray,
        half: np.ndarray,
        window_s: tuple[float, float],
    ) -> None:
        """Draw values ± half widths, (F,), in the chosen unit."""
        times, low = decimated(facts.times_s, values - half, window_s, facts.gaps)
        _, high = decimated(facts.times_s, values + half, window_s, facts.gaps)
        self.low.setData(times, low)
        self.high.setData(times, high)
        path, polygon = QPainterPath(), pg.functions.arrayToQPolygonF
        known = np.isfinite(low)
        for run in np.split(np.arange(len(low)), np.flatnonzero(np.diff(known)) + 1):
            if len(run) > 1 and known[run[0]]:
                outline_s = np.concatenate([times[run], times[run][::-1]])
                path.addPolygon(polygon(outline_s, np.concatenate([low[run], high[run][::-1]])))
        self.fill.setPath(path)


def isolated(values: np.ndarray) -> np.ndarray:
    """Known frames without known neighbours, (F,) bool; no line shows them."""
    known = np.pad(np.isfinite(values), 1)
    return known[1:-1] & ~known[:-2] & ~known[2:]


# Estimated force over that of a wrench sensor.

DOT, RING = 4, 9
"""Sizes of a frame and of the mark around the one at the cursor, px."""
REACH = 8.0
"""Largest distance of a click from the middle of its point, px."""


class WrenchPlot(FramePlot):
    """Each computed frame as a point; on the line both forces are equal."""

    def __init__(self, state: SessionState) -> None:
        super().__init__("number", mouse="xy")
        self._state = state
        self.add_line(angle=45)
        self.dots, self.here = self.add_dots(DOT, BLUE), self.add_dots(RING, ORANGE, filled=False)
        self._forces = np.empty((2, 0))  # (2, F), measured and estimated, as drawn

    def draw(self, _: object = None) -> None:
        """Draw the frames with both forces, in the chosen unit."""
        unit, history = self._state.units.force, self._state.history
        measured = unit.per_si * history.quantity(MEASURED_FORCE)
        estimated = unit.per_si * history.quantity("force_n")
        both = np.isfinite(measured) & np.isfinite(estimated)
        self.dots.setData(measured[both], estimated[both])
        self._forces = np.where(both, [measured, estimated], np.nan)
        note = "" if np.isfinite(measured).any() else ": no wrench measured"
        self.write(f"{PLOTS['wrench'].title} ({unit.symbol}){note}")

    def show_cursor(self, frame: int, _: int | None) -> None:
        """Mark a frame, if it has both forces."""
        at = self._forces[:, frame : frame + 1]
        self.here.setData(*at[:, np.isfinite(at[0])])

    def frame_at(self, place: QPointF) -> int | None:
        """Frame whose point is at a position of the canvas, else None."""
        at, pixel = self.box.mapSceneToView(place), self.box.viewPixelSize()
        away = (self._forces - [[at.x()], [at.y()]]) / np.reshape(pixel, (2, 1))
        squares = np.where(np.isfinite(away), away, np.inf) ** 2
        inside = self.box.sceneBoundingRect().contains(place)
        if not (inside and squares.size and squares.sum(axis=0).min() <= REACH**2):
            return None
        return int(squares.sum(axis=0).argmin())
