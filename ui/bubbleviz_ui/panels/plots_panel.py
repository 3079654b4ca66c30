"""Plots panel: numbers of every frame computed so far over time, with one cursor through all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, QSize, QTimer
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QProgressBar, QPushButton, QVBoxLayout, QWidget

from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panels.binding import menu_button, watch_controls
from bubbleviz_ui.panels.kappa_panel import KappaPlot, kappa_at
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.panels.time_plot import TRACES, TimePlot
from bubbleviz_ui.playback.range_strip import Curve, RangeTable
from bubbleviz_ui.shell.dock import fill, scrolled

if TYPE_CHECKING:
    from bubbleviz_ui.panels.other_recording import Beside

EVERY_MS = 200
"""Curves take some ms to draw, and nobody reads faster."""
CELL = (310, 112)
"""Width and height of a plot with room to read it, screen pixels."""
FOLLOWED_S = 20.0
"""How much of a live source is in sight."""


class PlotsPanel(QWidget):
    """Chosen plots in a grid; clicking one seeks. What is not chosen is not asked for."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self.setObjectName("plots")
        self._state, self._controller = state, controller
        self._due = QTimer(self, singleShot=True, interval=EVERY_MS)
        self._due.timeout.connect(lambda: self._draw())
        self._host = PlotHost(self._make)
        self._arranged: list[tuple[int, int, int]] | None = None
        self._pointed: tuple[str, float] | None = None
        self._beside: Beside | None = None
        self.plots: dict[str, TimePlot] = {}
        self.kappa: KappaPlot | None = None
        self.choose, self.boxes = menu_button(state, "plots")
        self.analyse = QPushButton("Analyse all frames")
        self.analyse.setToolTip("Compute these plots for all frames, in the background")
        self.cancel = QPushButton("Cancel")
        self.cancel.setToolTip("Stop and keep the frames computed so far")
        self.progress = QProgressBar()
        self.statistics = RangeTable()
        self.hint = QLabel("Click in a plot to go to that time")
        self.hint.setObjectName("dim")
        self._lay_out()
        self._connect()
        watch_controls(self)
        state.frame_changed.connect(self._on_frame)
        state.history_changed.connect(self._later)
        state.range_changed.connect(self._show_statistics)
        state.source_changed.connect(self._on_source)
        state.settings_changed.connect(self._on_settings)

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
        self._column = fill(
            QVBoxLayout(self),
            row,
            (scrolled(self._host), 1),
            self.statistics,
            margins=(8, 4, 8, 4),
            spacing=4,
        )
        self.progress.setFixedWidth(160)
        self.progress.hide()
        self.cancel.hide()

    def _connect(self) -> None:
        self.analyse.clicked.connect(lambda: self._controller.analysis.start())
        self.cancel.clicked.connect(lambda: self._controller.analysis.stop())
        self._controller.analysis.progressed.connect(self._on_analysed)
        self._controller.shown.connect(self._show_kappa)
        self._host.seen.connect(self._on_seen)

    def show_beside(self, beside: Beside | None) -> None:
        """Draw another recording's curves, too, or none."""
        self._beside = beside
        self._draw()

    # -- events -------------------------------------------------------------------------------

    def _on_frame(self, _: int, by_playback: bool) -> None:
        self._later() if by_playback else self._draw_cursor()

    def _on_source(self) -> None:
        self._show_all_time()
        self._draw()

    def _on_settings(self, names: frozenset[str]) -> None:
        if "plots" in names:
            self._arrange()
        self._draw()

    def _later(self) -> None:
        """Draw soon, once for all that changes until then."""
        if self._host.ready and not self._due.isActive():
            self._due.start()

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
        """Room for two rows of plots, before there are any; less is scrolled."""
        width, height = CELL
        header = self.choose.sizeHint().height() + self._column.spacing()
        return QSize(2 * width, 2 * height + header).grownBy(self._column.contentsMargins())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """As many plots side by side as have room."""
        super().resizeEvent(event)
        self._arrange()

    # -- drawing ------------------------------------------------------------------------------

    def _make(self) -> list[Part]:
        for name, trace in TRACES.items():
            self.plots[name] = plot = TimePlot(trace)
            plot.box.sigXRangeChanged.connect(self._later)
            plot.cursor.sigDragged.connect(self._on_dragged)
        self.kappa = KappaPlot()
        self.kappa.line.sigPositionChangeFinished.connect(self._on_kappa)
        self._host.canvas.scene().sigMouseClicked.connect(self._on_click)
        self._host.canvas.scene().sigMouseMoved.connect(self._on_mouse)
        self._host.canvas.installEventFilter(self)
        self._show_all_time()
        return [*self.plots.values(), self.kappa]

    def _shown(self) -> list[Any]:
        everything: dict[str, Any] = {**self.plots, "kappa": self.kappa}
        return [plot for name, plot in everything.items() if name in self._state.settings.plots]

    def _arrange(self) -> None:
        """Put the chosen plots into a grid."""
        if self._host.canvas is None:
            return
        shown = self._shown()
        columns = min(max(self.width() // CELL[0], 1), max(len(shown), 1))
        columns = -(-len(shown) // -(-len(shown) // columns)) if shown else 1
        wanted = [(id(plot), k // columns, k % columns) for k, plot in enumerate(shown)]
        if wanted == self._arranged:
            return
        self._arranged = wanted
        self._host.canvas.setMinimumHeight(CELL[1] * -(-len(shown) // columns))
        self._host.arrange([plot.frame.item for plot in shown], columns)
        timed = [plot for plot in shown if isinstance(plot, TimePlot)]
        for plot in timed[1:]:
            plot.box.setXLink(timed[0].box)

    def _draw(self) -> None:
        """Draw all curves anew."""
        facts = self._state.facts
        if not self._host.ready or facts is None:
            return
        if facts.grows and not self._state.frozen:
            self._follow(float(facts.times_s[-1]))
        for name, plot in self.plots.items():
            if name in self._state.settings.plots:
                plot.draw(facts, self._state.history, self._state.units)
                plot.draw_beside(self._beside, self._state.units)
        self._draw_cursor()
        self._show_statistics()

    def _follow(self, now_s: float) -> None:
        """Keep the last seconds of a live source in sight."""
        for plot in self.plots.values():
            plot.show_last(now_s, FOLLOWED_S)

    def _draw_cursor(self) -> None:
        facts = self._state.facts
        if not self._host.ready or facts is None:
            return
        frame = min(self._state.playhead, facts.frames - 1)
        for name, plot in self.plots.items():
            if name in self._state.settings.plots:
                plot.show_cursor(frame, float(facts.times_s[frame]), self._state.units)
        if self._pointed is not None:
            name, time_s = self._pointed
            frame = _nearest(facts.times_s, time_s)
            time_s = float(facts.times_s[frame])
            self.plots[name].show_pointed(frame, time_s, self._state.units)

    def _show_statistics(self) -> None:
        """Write the numbers of the range on the timeline, where there is one."""
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
        found = self._under(event.scenePos())
        if found is not None:
            self._seek(found[1])
            event.accept()

    def _on_mouse(self, place: QPointF) -> None:
        """Write the numbers under the mouse above its plot."""
        self._pointed = self._under(place)
        self._draw_cursor()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Notice that the mouse has left the plots."""
        if event.type() == QEvent.Type.Leave:
            self._pointed = None
            self._draw_cursor()
        return False

    def _under(self, place: QPointF) -> tuple[str, float] | None:
        """Plot at a place of the canvas, and the time there, s."""
        for name, plot in self.plots.items():
            inside = plot.box.sceneBoundingRect().contains(place)
            if inside and name in self._state.settings.plots:
                return name, float(plot.box.mapSceneToView(place).x())
        return None

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
