"""Live bar (source status, recording, publishing), and the latency of the display."""

from __future__ import annotations

import time
from collections import deque
from functools import partial
from pathlib import Path

from PySide6.QtCore import QObject, Qt
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import (
    QFileDialog,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz.live import Counters, LatencyMeter, LatencyReport
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.wording import count_of, minutes_and_seconds
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.live.live_controller import LiveController
from bubbleviz_ui.live.recording_control import new_name
from bubbleviz_ui.live.sensor_group import SensorGroup
from bubbleviz_ui.model.source_facts import Badge, untrusted_text
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import BarLayout, Elided, fill, tool_button
from bubbleviz_ui.shell.file_dialogs import remember
from bubbleviz_ui.shell.shortcuts import Shortcuts
from bubbleviz_ui.view3d.render_view import View

BADGES: dict[Badge, str] = {
    "connecting": theme.BLUE,
    "live": theme.GREEN,
    "frozen": theme.BLUE,
    "simulated": theme.YELLOW,
    "stale": theme.ORANGE,
    "reconnecting": theme.ORANGE,
    "ended": theme.NEUTRAL,
    "disconnected": theme.NEUTRAL,
}
"""Colour of each badge."""

SENSOR_TIP = "Show this sensor in the panels (B: switch sensor)"
RATE_SAMPLES = 11
RATE_FROM_S = 0.5
"""The rate is computed over the last updates, once they span this time."""

FAULT_COUNTERS = {
    "out_of_order": "out of order",
    "duplicate": "duplicate",
    "undecodable": "undecodable",
    "wrong_type": "of wrong type",
    "wrong_size": "of wrong size",
    "bad_stamps": "with bad stamps",
    "clock_jumps": "clock jumps",
    "missed": "lost",
}
"""Counters that are shown if not zero."""


class LiveBar(QFrame):
    """Badge and controls, wrapped into rows if narrow; message counters below."""

    def __init__(
        self, live: LiveController, controller: Controller, group: SensorGroup, units: Units
    ) -> None:
        super().__init__()
        self._live, self._controller, self._units = live, controller, units
        self._group = group
        self.state = QLabel(wordWrap=True)
        # in a narrow bar the rate needs a second line at times: the bar does not jump
        self.state.setMinimumHeight(2 * self.state.fontMetrics().height())
        self.sensors: list[QToolButton] = []
        self.record, self.zero, self.publish, self.leave = (QToolButton() for _ in range(4))
        self.note = QLineEdit()
        self.note.setPlaceholderText("Note, stamped with the time when you began to write")
        self.note.setMinimumWidth(100)
        self.note.setToolTip("Enter saves the note in the recording")
        self.note.hide()
        self._noted_ns: int | None = None
        self.counts = Elided(Qt.TextElideMode.ElideRight)
        theme.dim(self.counts)
        row, head, none = QWidget(), QWidget(), (0, 0, 0, 0)
        left = (self.state, 1), self.leave, self.note
        self._head = fill(QHBoxLayout(head), *left, margins=none, spacing=6)
        BarLayout(row, head, self.record, self.zero, self.publish, margins=none)
        fill(QVBoxLayout(self), row, self.counts, margins=(12, 5, 8, 5), spacing=3)
        self._connect()
        self.show_all()

    def use_actions(self, shortcuts: Shortcuts) -> None:
        """Give the buttons the function, state and tool tip of the menu's actions."""
        buttons = {
            self.record: "Record",
            self.zero: "Zero gas pressure",
            self.publish: "Publish results",
            self.leave: "Disconnect",
        }
        shortcuts.give(buttons, "Live")
        self._name(self.zero, "Zero gas")
        self._name(self.publish, "Publish")
        self.show_all()

    @staticmethod
    def _name(button: QToolButton, text: str) -> None:
        if (action := button.defaultAction()) is not None:
            action.setIconText(text)

    def show_all(self) -> None:
        """Update everything after a change of session or source."""
        run, waits = self._live.run, self._live.connection is not None
        left = self._live.state.badge == "disconnected"
        self.setVisible(run is not None or waits or left or bool(self._controller.group))
        for widget in (self.record, self.zero, self.publish, self.counts):
            widget.setVisible(run is not None)
        self.leave.setVisible(run is not None or waits)
        self._name(self.leave, "Cancel" if waits else "Disconnect")
        self._make_sensors()
        self._rate_samples = None
        self.update_status()

    def update_status(self) -> None:
        """Update badge, rate and counters."""
        live = self._live
        self._show_untrusted()
        if live.connection is not None:  # perhaps to another source
            self._show_badge("connecting", live.connection.text())
        elif live.sensor is None:
            self._show_badge(live.state.badge)
        if live.sensor is None:
            return
        progress = self._show_recording()
        status, counters = live.sensor.stream.status(), live.sensor.stream.counters
        if live.connection is None:
            drawn = live.connection_state != "connecting"  # until then something else may be open
            badge = live.state.badge if drawn else "connecting"
            self._show_badge(badge, status.silence or self._rate_text(counters.frames, badge))
        # faults first: a narrow bar elides the rest
        texts = [
            *fault_texts(counters),
            *progress,
            self._zero_text(),
            count_of(counters.received, "message"),
            count_of(counters.frames, "image"),
            f"{count_of(counters.skipped, 'image')} skipped",
        ]
        counts = "  ·  ".join(texts)
        self.counts.setText(counts)
        self.counts.setToolTip(counts)

    # -- inside -------------------------------------------------------------------------------

    def _connect(self) -> None:
        live = self._live
        live.changed.connect(self.show_all)
        self._controller.group_changed.connect(self.show_all)
        live.updated.connect(self.update_status)
        live.state.source_changed.connect(self.show_all)
        live.state.frozen_changed.connect(self.update_status)
        live.state.connection_changed.connect(self.update_status)
        self.note.returnPressed.connect(self._save_note)
        self.note.editingFinished.connect(self.note.hide)

    def start_note(self) -> None:
        """Open the box for a note with the current time."""
        if self._live.recording.busy:
            self._noted_ns = time.time_ns()
            self.note.clear()
            self.note.show()
            self.note.setFocus()

    def _save_note(self) -> None:
        text = self.note.text().strip()
        if text:
            self._live.recording.mark(text, self._noted_ns)
        self.note.clearFocus()

    def choose_folder(self) -> None:
        folder = self._live.recording.folder
        present = folder if folder.is_dir() else folder.parent  # created with the first recording
        name = QFileDialog.getExistingDirectory(self, "Record into", str(present))
        if name:
            self._live.state.change(record_folder=name)
            remember("recording", new_name(Path(name)))

    def _show_recording(self) -> list[str]:
        """Update button and note of recording; returns its progress, if any."""
        recording, button = self._live.recording, self.record
        status, busy = recording.status(), recording.busy
        self._name(button, "■ Stop" if busy else "● Record")
        # at least as wide as it was before: other controls do not move
        button.setMinimumWidth(max(button.minimumWidth(), button.sizeHint().width()))
        if not busy:
            self.note.hide()
        if status is None:
            return []
        written, waiting = (size / 1e6 for size in (status.size_bytes, status.waiting_bytes))
        return [
            f"{minutes_and_seconds(recording.elapsed_s)} · {written:.1f} MB · "
            f"{count_of(status.messages, 'message')} · {waiting:.1f} MB unwritten"
        ]

    def _make_sensors(self) -> None:
        """Create a button for each of two sensors."""
        while self.sensors:
            button = self.sensors.pop()
            self._head.removeWidget(button)
            button.deleteLater()
        for number, sensor in enumerate(self._controller.group):
            select = partial(self._choose, number)
            button = tool_button(f"● {sensor.name}", SENSOR_TIP, select, checkable=True)
            own = QPalette()
            for role in (theme.ROLES.ButtonText, theme.ROLES.Highlight):
                own.setColor(role, QColor(sensor.colour))
            own.setColor(theme.ROLES.HighlightedText, QColor(theme.ON_BADGE))
            button.setPalette(own)
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.setChecked(number == self._controller.chosen)
            self._head.addWidget(button)
            self.sensors.append(button)

    def _choose(self, number: int) -> None:
        self._group.choose(number)
        for k, button in enumerate(self.sensors):  # the click has changed one
            button.setChecked(k == self._controller.chosen)

    def _show_untrusted(self) -> None:
        """Show untrusted results on the buttons, as the readout is only of the selected sensor."""
        for client, button in zip(self._controller.clients, self.sensors, strict=False):
            name, doubt = client.name, untrusted_text(client.result)
            button.setText(f"● {name}: {doubt.partition(':')[0]}" if doubt else f"● {name}")
            button.setToolTip(doubt or SENSOR_TIP)

    def _show_badge(self, badge: Badge, text: str = "") -> None:
        colours = f"background-color:{BADGES[badge]}; color:{theme.ON_BADGE}" if badge else ""
        self.state.setText(f'<b style="{colours}">&nbsp;{badge}&nbsp;</b>&nbsp; {text}')

    def _rate_text(self, frames: int, badge: Badge) -> str:
        """Rate of received images, and rate and age of those shown; empty until known."""
        now = time.monotonic()
        if self._rate_samples is None or frames < self._rate_samples[-1][1]:
            self._rate_samples = deque([(now, frames)], maxlen=RATE_SAMPLES)
        self._rate_samples.append((now, frames))
        then, before = self._rate_samples[0]
        if now - then < RATE_FROM_S:
            return ""
        text = self._units.rate.text((frames - before) / (now - then))
        if badge not in ("frozen", "ended"):
            shown_hz = self._controller.client.solve_rate.rate_hz(time.perf_counter())
            text += f", shown {self._units.rate.text(shown_hz)}"
        return f"{text}, {self._live.shown_age_s:.1f}&nbsp;s&nbsp;old" if badge == "stale" else text

    _rate_samples: deque[tuple[float, int]] | None = None

    def _zero_text(self) -> str:
        sensor = self._live.sensor
        if sensor is None or (sensor.zero.waiting and sensor.zero.offset_pa is None):
            return "gas zero unknown: no contact-free frames yet"
        offset = self._units.gas_pressure.text(sensor.zero.offset_pa, signed=True)
        return f"gas zero {offset}" + (
            ", waiting for contact-free frames" if sensor.zero.waiting else ""
        )


def fault_texts(counters: Counters) -> list[str]:
    """The last problem, and the counters of faults that are not zero."""
    counts = {word: getattr(counters, name) for name, word in FAULT_COUNTERS.items()}
    problem = [counters.problem] if counters.problem else []
    return problem + [f"{count} {word}" for word, count in counts.items() if count]


# Latency from the time stamp of a live frame to its display.


class DisplayLatency(QObject):
    """Measures the latency from stamp to display, or from arrival if the clocks differ."""

    def __init__(self, controller: Controller, view: View) -> None:
        super().__init__()
        self._shown: Frame | None = None
        self._meter = LatencyMeter()
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        view.rendered.connect(self._on_rendered)

    def begin(self, pictures: int = 600) -> None:
        """Restart the measurement, over the last `pictures`."""
        self._shown, self._meter = None, LatencyMeter(pictures)

    def _on_opened(self, _: object) -> None:
        self.begin()

    def report(self) -> LatencyReport | None:
        """Latency statistics; None without live pictures."""
        return self._meter.report()

    def _on_shown(self, result: Result) -> None:
        fresh = result.frame.arrival_ns > 0 and result.frame is not self._shown
        self._shown = result.frame if fresh else None

    def _on_rendered(self) -> None:
        frame, self._shown = self._shown, None
        if frame is not None:
            self._meter.add(frame, time.time_ns())
