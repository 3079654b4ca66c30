"""Plots panel: quantities of all computed frames over time, with a common cursor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import QPointF, QSize
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QVBoxLayout, QWidget

from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.registry import PLOTS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PATCH_SETTINGS
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.model.units import UNIT_CHOICES
from bubbleviz_ui.panels.kappa_panel import KappaPlot, kappa_at
from bubbleviz_ui.panels.plot_host import LEAST_HEIGHT, PlotHost
from bubbleviz_ui.panels.time_plot import TRACES, TimePlot
from bubbleviz_ui.panels.wrench_plot import WrenchPlot
from bubbleviz_ui.playback.range_strip import Curve, RangeTable
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import menu_button
from bubbleviz_ui.shell.dock import fill, push_button, scrolled

if TYPE_CHECKING:
    from bubbleviz_ui.panels.other_recording import AlignedRun

EVERY_MS = 200
"""Redraw period; drawing the curves takes some ms."""
CELL = (310, 112)
"""Smallest width and height of a plot, screen pixels."""
DRAWN = PATCH_SETTINGS | UNIT_CHOICES.keys() | {"plots"}
"""Settings whose change redraws the curves."""
LIVE_WINDOW_S = 20.0
"""Time span shown of a live source."""


class PlotsPanel(QWidget):
    """Chosen plots in a grid; a click seeks. Only chosen quantities are computed."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self.setObjectName("plots")
        self._state, self._controller = state, controller
        self._redraw = Throttle(self, self._draw, EVERY_MS)
        self._host = PlotHost()  # each plot is created when it is first chosen
        self._hovered: tuple[str, float] | None = None
        self.plots: dict[str, TimePlot] = {}
        self.kappa: KappaPlot | None = None
        self.wrench: WrenchPlot | None = None
        self.choose, self.boxes = menu_button(state, "plots")
        self.analyse = push_button(
            "Analyse all frames",
            "Compute these plots for all frames, in the background",
            controller.analysis.start,
        )
        self.cancel = push_button(
            "Cancel", "Stop and keep the frames computed so far", controller.analysis.stop
        )
        self.progress = QProgressBar()
        self.statistics = RangeTable()
        self.hint = theme.dim(QLabel("Click in a plot to show that frame"))
        self._lay_out()
        self._connect()
        state.frame_changed.connect(self._on_frame)
        state.history_changed.connect(self._redraw.request)
        state.range_changed.connect(self._show_statistics)
        state.source_changed.connect(self._on_source)
        state.follow({"plots"}, self._arrange)
        state.follow(DRAWN, self._draw)

    def _lay_out(self) -> None:
        row = fill(
            QHBoxLayout(),
            self.choose,
            self.analyse,
            self.progress,
            self.cancel,
            1,
            self.hint,
            self.statistics.copy,
        )
        plots = scrolled(self._host)
        plots.setMinimumHeight(LEAST_HEIGHT)
        self._column = fill(
            QVBoxLayout(self),
            row,
            (plots, 1),
            self.statistics,
            margins=(8, 4, 8, 4),
            spacing=4,
        )
        self.progress.setFixedWidth(160)
        self.progress.hide()
        self.cancel.hide()

    def _connect(self) -> None:
        self._controller.analysis.progressed.connect(self._on_analysed)
        self._controller.shown.connect(self._on_shown)
        self._host.seen.connect(self._on_seen)
        self._host.pointed.connect(self._on_mouse)
        self._host.clicked.connect(self._on_click)

    def show_other(self, aligned: AlignedRun | None) -> None:
        """Draw another recording's curves, too, or none."""
        self._aligned = aligned
        self._draw()

    # -- events -------------------------------------------------------------------------------

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback:  # else when it is shown
            self._draw_cursor()

    def _on_shown(self) -> None:
        self._draw_cursor()
        self._show_kappa()

    def _on_source(self) -> None:
        self._show_all_time()
        self._draw()

    def _show_all_time(self) -> None:
        facts = self._state.facts
        if facts is not None:
            for plot in self.plots.values():
                plot.show_all(facts.times_s)

    def _on_analysed(self, done: int, frames: int) -> None:
        busy = done < frames
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.analyse.setEnabled(not busy)
        self.progress.setMaximum(max(frames, 1))
        self.progress.setValue(done)
        self.progress.setFormat(f"{done} / {frames}")

    def _on_seen(self) -> None:
        self._arrange()
        self._draw()
        self._show_kappa()

    def sizeHint(self) -> QSize:
        """Two rows of plots, even before any exist, and the table; a smaller panel scrolls."""
        width, height = CELL
        buttons = self.choose.sizeHint().expandedTo(self.analyse.sizeHint())
        rest = buttons.height() + self._column.spacing()
        if not self.statistics.isHidden():
            rest += self.statistics.maximumHeight() + self._column.spacing()
        return QSize(2 * width, 2 * height + rest).grownBy(self._column.contentsMargins())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Adapt the number of columns."""
        super().resizeEvent(event)
        self._arrange()

    # -- drawing ------------------------------------------------------------------------------

    def _shown(self) -> list[Any]:
        """The chosen plots, created where they are new."""
        return [self._plot(name) for name in PLOTS if name in self._state.settings.plots]

    def _plot(self, name: str) -> TimePlot | KappaPlot | WrenchPlot:
        made = {**self.plots, "kappa": self.kappa, "wrench": self.wrench}.get(name)
        if made is None:
            made = self._new_plot(name)
            self._host.add(made)
        return made

    def _new_plot(self, name: str) -> TimePlot | KappaPlot | WrenchPlot:
        if name == "wrench":
            self.wrench = WrenchPlot()
            return self.wrench
        if name == "kappa":
            self.kappa = KappaPlot()
            self.kappa.line.sigPositionChangeFinished.connect(self._on_kappa)
            return self.kappa
        self.plots[name] = plot = TimePlot(TRACES[name])
        plot.cursor.sigDragged.connect(self._on_dragged)
        if self._state.facts is not None:
            plot.show_all(self._state.facts.times_s)
        plot.box.sigXRangeChanged.connect(self._redraw.request)
        return plot

    def _arrange(self) -> None:
        """Arrange the chosen plots in a grid."""
        if self._host.canvas is None:
            return
        shown = self._shown()
        columns = min(max(self.width() // CELL[0], 1), max(len(shown), 1))
        columns = -(-len(shown) // -(-len(shown) // columns)) if shown else 1
        if not self._host.arrange([plot.item for plot in shown], columns):
            return
        self._host.canvas.setMinimumHeight(CELL[1] * -(-len(shown) // columns))
        timed = [plot for plot in shown if isinstance(plot, TimePlot)]
        for plot in timed[1:]:
            plot.box.setXLink(timed[0].box)

    def _draw(self) -> None:
        """Redraw all curves."""
        facts = self._state.facts
        if not self._host.ready or facts is None:
            return
        if facts.grows and not self._state.frozen:
            self._show_last(float(facts.times_s[-1]) + 1e-3 * EVERY_MS)  # room for the cursor
        for name, plot in self.plots.items():
            if name in self._state.settings.plots:
                plot.draw(facts, self._state.history, self._state.units)
                plot.draw_other(self._aligned, self._state.units)
        if self.wrench is not None and "wrench" in self._state.settings.plots:
            self.wrench.draw(self._state.history, self._state.units)
        self._draw_cursor()
        self._show_statistics()

    def _show_last(self, now_s: float) -> None:
        """Show the last `LIVE_WINDOW_S` of a live source."""
        for plot in self.plots.values():
            plot.show_last(now_s, LIVE_WINDOW_S)

    def _draw_cursor(self) -> None:
        facts = self._state.facts
        if not self._host.ready or facts is None:
            return
        frame = min(self._state.playhead, facts.frames - 1)
        for name, plot in self.plots.items():
            if name in self._state.settings.plots:
                plot.show_cursor(frame, float(facts.times_s[frame]), self._state.units)
        if self.wrench is not None and "wrench" in self._state.settings.plots:
            self.wrench.show_cursor(frame)
        if self._hovered is not None:
            name, time_s = self._hovered
            frame = _nearest(facts.times_s, time_s)
            time_s = float(facts.times_s[frame])
            self.plots[name].show_hovered(frame, time_s, self._state.units)

    def _show_statistics(self) -> None:
        """Show statistics of the range chosen on the timeline, if any."""
        if not self._host.ready:
            return
        state, curves = self._state, list[Curve]()
        first, last = state.play_range or (0, -1)
        if state.play_range is not None:
            curves = [
                Curve(
                    title, trace.unit(state.units), state.history.quantity(name)[first : last + 1]
                )
                for plot, trace in TRACES.items()
                if plot in state.settings.plots
                for name, title in trace.titles.items()
            ]
        sensor = self._controller.sensor
        name = "" if sensor is None else sensor.name
        self.statistics.show_range(first, last, curves, state.settings.kappa, name)

    def _show_kappa(self) -> None:
        if self.kappa is not None and self._host.ready and "kappa" in self._state.settings.plots:
            result, curve = self._controller.result, self._controller.inspection.kappa_curve
            self.kappa.draw(curve, result, self._state.settings.kappa, self._state.units)

    def _on_click(self, event: Any) -> None:
        place = event.scenePos()
        found = self._under(place)
        if found is not None:
            self._seek(found[1])
            event.accept()
        elif self.wrench is not None and self._is_under(self.wrench, "wrench", place):
            frame = self.wrench.frame_at(place)
            if frame is not None:
                self._state.seek(frame)
                event.accept()

    def _on_mouse(self, place: QPointF | None) -> None:
        """Show the values under the mouse in the heading of the plot."""
        self._hovered = None if place is None else self._under(place)
        self._draw_cursor()

    def _under(self, place: QPointF) -> tuple[str, float] | None:
        """Plot at a position of the canvas, and its time there, s."""
        for name, plot in self.plots.items():
            if self._is_under(plot, name, place):
                return name, float(plot.box.mapSceneToView(place).x())
        return None

    def _is_under(self, plot: TimePlot | WrenchPlot, name: str, place: QPointF) -> bool:
        """Whether a position of the canvas is in a plot, which is shown."""
        inside = plot.box.sceneBoundingRect().contains(place)
        return bool(inside) and name in self._state.settings.plots

    def _on_dragged(self, line: Any) -> None:
        self._seek(float(line.value()))

    def _on_kappa(self, line: Any) -> None:
        self._state.change(kappa=kappa_at(line))

    def _seek(self, time_s: float) -> None:
        facts = self._state.facts
        if facts is not None:
            self._state.seek(_nearest(facts.times_s, time_s))


def _nearest(times_s: np.ndarray, time_s: float) -> int:
    """Frame nearest to a time."""
    return int(np.abs(times_s - time_s).argmin())
