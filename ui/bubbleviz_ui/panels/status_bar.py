"""Status bar: sensor, numbers of the frame shown, frame rates; performance pop-up."""

from __future__ import annotations

import math
from statistics import median

from PySide6.QtCore import QPoint, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QMouseEvent, QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QStatusBar, QVBoxLayout, QWidget

from bubbleviz.live import LatencyReport
from bubbleviz.result import Result
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.demand import STAGES, StageTimes, names_by_stage
from bubbleviz_ui.model.frame_history import FrameHistory
from bubbleviz_ui.model.registry import LAYERS, PANELS
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.source_facts import SourceFacts, force_text, friction_text, untrusted_text
from bubbleviz_ui.model.units import DASH, Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import Elided, Steady, fill
from bubbleviz_ui.shell.table import Table
from bubbleviz_ui.view3d.render_view import View

TIPS = {
    "sensor": "Sensor",
    "frame": "Number of the frame shown, of a recording also the first and last number, and the "
    "frame's time since the start",
    "force": "Force F: resultant of contact pressure p_c (Eq. 23) and friction on the membrane,"
    " ± half of its 95 % interval due to noise, friction, γ0, gauge pressure and λ; "
    "≈ until the frame is solved from rest",
    "area": "Area of the contact patch on the membrane at rest (section V-C of the paper); the "
    "Contact patch panel shows the threshold",
    "gas": "Gas pressure change p_v from rest: measured, else from the gas law (Eq. 6) and the "
    "estimated shape; result files have an estimate that combines both",
    "residual": "Root mean square of measured minus modelled range (Eq. 19)",
    "camera": "Mean rate of the depth images of the open source",
    "solve": "Run time of the frame shown, depth image in to results out, and frames processed in "
    "the last second; click for more",
    "latency": "From the time stamp of a live frame (its arrival if the clocks differ) to its "
    "display: median and 95th percentile",
    "render": "Pictures of the 3-D view drawn in the last second",
    "dropped": "Frames skipped because a newer one was due, or another one requested",
}


CLICKABLE = ("solve", "render", "dropped")
"""Labels that open the performance pop-up on a click."""

SPACING = 12  # px, largest distance of labels in a QStatusBar
HIDING_ORDER = (
    "dropped",
    "render",
    "camera",
    "solve",
    "residual",
    "gas",
    "latency",
    "area",
    "sensor",
)
"""Labels hidden in a narrow window, first to last; the panels show the same numbers."""


def widest_texts(units: Units) -> dict[str, str]:
    """The longest text to expect of each label."""
    return {
        "sensor": "soft-bubble 75 mm (preset)",
        "frame": "frame 888 of 0–888 · 88.888 s",
        "force": f"force ≈ {units.force.with_interval(88.88, 0.88)}",
        "area": f"patch {units.area.text(8.888e-3)}",
        "gas": f"p_v {units.gas_pressure.text(8888.0, signed=True)}",
        "residual": f"residual {units.length.text(8.88e-3)}",
        "camera": "camera 88.8 Hz",
        "solve": f"solve {units.duration.text(88.8)} · 88.8 Hz",
        "latency": f"latency {units.duration.text(88.8)}, {units.duration.text(188.8)}",
        "render": "render 88 fps",
        "dropped": "dropped 8888 frames",
    }


class StatusBar(QStatusBar):
    """One label per quantity, as wide as its longest text, so that none moves.

    A narrow window shows only the more important ones.
    """

    clicked = Signal()  # On a label of `CLICKABLE`

    def __init__(self, units: Units) -> None:
        super().__init__()
        self._units = units
        self.setSizeGripEnabled(False)
        self.setContentsMargins(10, 2, 10, 2)
        self.labels = {name: self._label(name) for name in TIPS}
        for name, label in self.labels.items():
            self.addWidget(label, 1 if name == "sensor" else 0)
        self._available = set(TIPS) - {"latency"}
        self.fit_units()

    @property
    def numbers(self) -> tuple[QLabel, ...]:
        """Labels with numbers of the frame shown."""
        return tuple(self.labels[name] for name in ("frame", "force", "area", "gas", "residual"))

    def fit_units(self) -> None:
        """Make each label as wide as its longest text in the current units."""
        for name, text in widest_texts(self._units).items():
            label = self.labels[name]
            width = label.fontMetrics().horizontalAdvance(text) + 6
            if isinstance(label, Steady):
                label.fix_width(width)
            else:
                label.setMinimumWidth(width)
        self._fit()

    def show_source(self, facts: SourceFacts, sensor: str) -> None:
        """Show what is constant for a source; `sensor`: its name and file."""
        self.labels["sensor"].setText(sensor)
        self.labels["sensor"].setToolTip(f"Sensor: {sensor}; source: {facts.title}")
        self.labels["camera"].setText(f"camera {self._units.rate.text(facts.rate_hz)}")
        zero = f"\n{facts.gas_zero}" if facts.gas_zero else ""
        self.labels["gas"].setToolTip(TIPS["gas"] + zero)
        # the live bar shows these numbers of a stream
        self._available = set(TIPS) - ({"camera", "dropped"} if facts.grows else {"latency"})
        self._fit()
        self.show_latency(None)

    def show_result(
        self,
        result: Result,
        facts: SourceFacts,
        history: FrameHistory,
        *,
        final: bool,
        sensor: str = "",
    ) -> None:
        """Show the numbers of a result; `final`: whether they are final.

        `sensor`: Name of the sensor if there are two.
        """
        of = f"{sensor}: " if sensor else ""
        units, frame = self._units, result.frame
        estimate, patch = result.trusted_estimate, result.trusted_patch
        texts = {
            "frame": facts.frame_text(frame.index, units, " · "),
            "force": f"{of}force " + force_text(result, units, final=final),
            "area": "patch " + units.area.text(patch.area_m2 if patch else None),
            "gas": self._gas_text(frame.index, history),
            "residual": "residual "
            + units.length.text(estimate.residual_rms_m if estimate else None),
        }
        for name, text in texts.items():
            self.labels[name].setText(text)
        if sensor:
            self._fit()  # its name needs room
        part = friction_text(result, units)
        known = f"{part} (friction was not estimated)" if part == DASH and patch else part
        friction = f"its part by friction: {known}"
        mean = f"\nfrom the mean of {frame.images} depth images" if frame.images > 1 else ""
        caveat = f"{estimate.caveat};\n" if estimate and estimate.caveat else ""
        tip = f"{TIPS['force']};\n{caveat}{friction}{mean}"
        self.labels["force"].setToolTip(untrusted_text(result) or tip)
        self._solve_ms = result.times_ms.get("total")

    def show_rates(self, solve_hz: float, render_hz: float, dropped: int) -> None:
        """Show frame rates and the number of dropped frames."""
        units = self._units
        solve = f"{units.duration.text(self._solve_ms)} · {units.rate.text(solve_hz)}"
        self.labels["solve"].setText(f"solve {solve}")
        self.labels["render"].setText(f"render {units.render_rate.text(render_hz)}")
        self.labels["dropped"].setText(f"dropped {count_of(dropped, 'frame')}")

    def show_latency(self, report: LatencyReport | None) -> None:
        """Show the latency from time stamp to display."""
        text = self._units.duration.text
        median, p95 = (None, None) if report is None else (report.median_s, report.p95_s)
        ms = [None if s is None else 1e3 * s for s in (median, p95)]
        self.labels["latency"].setText(f"latency {text(ms[0])}, {text(ms[1])}")

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Emit `clicked` for labels of `CLICKABLE`."""
        child = self.childAt(event.position().toPoint())
        if child in [self.labels[name] for name in CLICKABLE]:
            self.clicked.emit()
        super().mousePressEvent(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Hide labels that do not fit."""
        super().resizeEvent(event)
        self._fit()

    def minimumSizeHint(self) -> QSize:
        """No minimum width."""
        return QSize(0, super().minimumSizeHint().height())

    def _fit(self) -> None:
        """Hide labels that do not fit."""
        margins = self.contentsMargins()
        room = self.width() - margins.left() - margins.right()
        shown = set(self._available)
        for name in HIDING_ORDER:
            if sum(self.labels[each].minimumWidth() + SPACING for each in shown) <= room:
                break
            shown.discard(name)
        for name, label in self.labels.items():
            label.setVisible(name in shown)

    def _gas_text(self, frame: int, history: FrameHistory) -> str:
        """Gas pressure change of a frame: measured, else from the gas law."""
        curves = [history.quantity(name) for name in ("gas_measured_pa", "gas_law_pa")]
        known = [float(curve[frame]) for curve in curves if frame < len(curve)]
        change = next((value for value in known if math.isfinite(value)), None)
        return f"p_v {self._units.gas_pressure.text(change, signed=True)}"

    _solve_ms: float | None = None

    def _label(self, name: str) -> QLabel:
        middle = Qt.TextElideMode.ElideMiddle  # keep start of the name and end of the file
        label = Elided(middle) if name == "sensor" else Steady()
        label.setToolTip(TIPS[name])
        label.setAlignment(Qt.AlignmentFlag.AlignCenter)
        return label


# Performance pop-up: run time of each stage, and the layers and panels that need it.

EVERY_MS = 500
COLUMNS = ("Stage", "last", "median", "runs", "Why it runs")
WIDTH = 860  # px: all columns
IDLE = "idle: nothing needs it"


class PerformancePopup(QFrame):
    """Table of the stages, updated while it is open."""

    def __init__(
        self,
        parent: QWidget,
        state: SessionState,
        controller: Controller,
        stage_times: StageTimes,
        view: View,
    ) -> None:
        super().__init__(parent, Qt.WindowType.Popup)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._state, self._controller = state, controller
        self._stage_times, self._view = stage_times, view
        self.table = Table(COLUMNS, len(COLUMNS) - 1)
        self.drawing, title = QLabel(), theme.bold(QLabel("Performance"))
        hint = theme.dim(
            QLabel("Hiding a layer or closing a panel stops computations that only it needs.")
        )
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.setFixedWidth(WIDTH)
        fill(QVBoxLayout(self), title, self.table, self.drawing, hint)
        self._timer = QTimer(self, interval=EVERY_MS)
        self._timer.timeout.connect(lambda: self.refresh())
        self._timer.start()
        self.refresh()

    def open_over(self, bar: QWidget) -> None:
        """Open above the right end of the status bar."""
        corner = bar.mapToGlobal(QPoint(bar.width(), 0))
        self.adjustSize()
        self.move(corner.x() - self.width() - 8, corner.y() - self.height() - 4)
        self.show()

    def refresh(self) -> None:
        analysing, duration = self._controller.analysis.busy, self._state.units.duration
        requested = names_by_stage(self._state.settings, analysing=analysing)
        counts, right = self._controller.client.solver.counts, range(1, len(COLUMNS) - 1)
        self.table.setRowCount(len(STAGES))
        for row, (stage, title) in enumerate(STAGES.items()):
            times = self._stage_times.of[stage]
            last, typical = (times[-1], median(times)) if times else (None, None)
            why = ", ".join(map(_title, requested.get(stage, ()))) or IDLE
            texts = title, duration.text(last), duration.text(typical), f"{counts.get(stage, 0)}×"
            of_all = stage == "total"
            self.table.write(
                row, (*texts, "" if of_all else why), right=right, dim=why == IDLE and not of_all
            )
        self.table.setFixedHeight(self.table.full_height)
        view = self._view
        each = 1e3 * view.busy_s / view.render_count if view.render_count else None
        self.drawing.setText(
            f"Drawing: {duration.text(each)} a picture, {count_of(view.render_count, 'picture')},"
            f" {count_of(self._controller.dropped, 'frame')} skipped because a newer one was due, "
            "or another one requested"
        )


def _title(name: str) -> str:
    if name in LAYERS:
        return LAYERS[name].title
    panel = PANELS.get(name)
    if panel is None:
        return name
    return f"{panel.title} panel" if panel.side else panel.title.lower()
