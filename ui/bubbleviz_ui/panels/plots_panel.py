"""Plots panel: quantities of all computed frames over time, with a common cursor."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QPointF, QSize
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QVBoxLayout, QWidget

from bubbleviz.wording import minutes_and_seconds
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.registry import PLOTS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PATCH_SETTINGS
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.model.units import UNIT_CHOICES
from bubbleviz_ui.panels.kappa_panel import KappaPlot
from bubbleviz_ui.panels.plot_host import LEAST_HEIGHT, PlotHost
from bubbleviz_ui.panels.time_plot import TRACES, FramePlot, TimePlot, WrenchPlot
from bubbleviz_ui.playback.range_strip import Curve, RangeTable
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import menu_button
from bubbleviz_ui.shell.dock import fill, push_button, scrolled

if TYPE_CHECKING:
    from bubbleviz_ui.panels.other_recording import AlignedRun

EVERY_MS = 200
"""Redraw period; drawing the curves takes some ms."""
CELL = (310, 112)
"""Smallest width of a plot and, where plots are scrolled, its height, screen pixels."""
DRAWN = PATCH_SETTINGS | UNIT_CHOICES.keys() | {"plots"}
"""Settings whose change redraws the curves."""


class PlotsPanel(QWidget):
    """Chosen plots in a grid; a click seeks. Only chosen quantities are computed."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._controller = state, controller
        self._redraw = Throttle(self, self._draw, EVERY_MS)
        self._host = PlotHost()  # each plot is created when it is first chosen
        self._pointed: QPointF | None = None  # Of the mouse in the canvas
        self._aligned: AlignedRun | None = None
        self.plots: dict[str, FramePlot] = {}
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
        self._controller.analysis.progressed.connect(self._on_analysed)
        self._controller.shown.connect(self._draw_cursor)
        self._host.seen.connect(self._on_seen)
        self._host.pointed.connect(self._on_mouse)
        self._host.clicked.connect(self._on_click)
        state.frame_changed.connect(self._on_frame)
        state.history_changed.connect(self._redraw.request)
        state.range_changed.connect(self._show_statistics)
        state.source_changed.connect(self._on_source)
        state.follow({"plots"}, self._arrange)
        state.follow(DRAWN, self._draw)
        self._on_source()

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
            QVBoxLayout(self), row, (plots, 1), self.statistics, margins=(8, 4, 8, 4), spacing=4
        )
        self.progress.setFixedWidth(200)
        self.progress.hide()
        self.cancel.hide()

    def show_other(self, aligned: AlignedRun | None) -> None:
        """Draw another recording's curves, too, or none."""
        self._aligned = aligned
        self._draw()

    # -- events -------------------------------------------------------------------------------

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback:  # else when it is shown
            self._draw_cursor()

    def _on_source(self) -> None:
        self.analyse.setDisabled(self._state.facts.is_empty)
        for plot in self.plots.values():
            plot.show_all()
        self._draw()

    def _on_analysed(self, done: int, frames: int) -> None:
        busy = done < frames
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.analyse.setVisible(not busy)  # the row has no room for all in a narrow window
        self.progress.setMaximum(max(frames, 1))
        self.progress.setValue(done)
        left_s = self._controller.analysis.remaining_s
        left = "" if math.isnan(left_s) else f", {minutes_and_seconds(left_s)} left"
        self.progress.setFormat(f"{done} / {frames}{left}")

    def _on_seen(self) -> None:
        self._arrange()
        self._draw()

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

    def _shown(self) -> list[FramePlot]:
        """The chosen plots, created where they are new."""
        return [self._plot(name) for name in PLOTS if name in self._state.settings.plots]

    def _plot(self, name: str) -> FramePlot:
        if name not in self.plots:
            self.plots[name] = plot = self._new_plot(name)
            self._host.add(plot)
        return self.plots[name]

    def _new_plot(self, name: str) -> FramePlot:
        if name == "wrench":
            return WrenchPlot(self._state)
        if name == "kappa":
            return KappaPlot(self._state, self._controller)
        plot = TimePlot(TRACES[name], self._state)
        plot.cursor.sigDragged.connect(self._on_dragged)
        plot.box.sigXRangeChanged.connect(self._redraw.request)
        return plot

    def _arrange(self) -> None:
        """Arrange the chosen plots in a grid, without an empty place unless it is scrolled."""
        if self._host.canvas is None:
            return
        shown = self._shown()
        columns = min(max(self.width() // CELL[0], 1), max(len(shown), 1))
        columns = -(-len(shown) // -(-len(shown) // columns)) if shown else 1
        height = CELL[1] * -(-len(shown) // columns)
        low = round(0.85 * height)  # what a window of 1024×700 px leaves at 150 %
        fits = self.height() - self.sizeHint().height() >= low - 2 * CELL[1]
        if not self._host.arrange([plot.item for plot in shown], columns, filled=fits):
            return
        self._host.canvas.setMinimumHeight(low if fits else height)
        timed = [plot for plot in shown if isinstance(plot, TimePlot)]
        for plot in timed[1:]:
            plot.box.setXLink(timed[0].box)

    def _draw(self) -> None:
        if self._host.ready:
            for plot in self._shown():
                plot.draw(self._aligned)
            self._draw_cursor()
            self._show_statistics()

    def _draw_cursor(self) -> None:
        if not self._host.ready:
            return
        pointed, frame = self._pointed, min(self._state.playhead, self._state.facts.frames - 1)
        for plot in self._shown():
            plot.show_cursor(frame, None if pointed is None else plot.frame_at(pointed))

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

    def _on_click(self, event: Any) -> None:
        for plot in self._shown():
            frame = plot.frame_at(event.scenePos())
            if frame is not None:
                self._state.seek(frame)
                event.accept()
                return

    def _on_dragged(self, line: Any) -> None:
        self._state.seek(self._state.frame_at(line.value()))

    def _on_mouse(self, place: QPointF | None) -> None:
        """Show the values under the mouse in the heading of the plot."""
        self._pointed = place
        self._draw_cursor()
