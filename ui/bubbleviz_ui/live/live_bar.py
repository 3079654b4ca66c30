"""Live bar: how the source is doing, and what one does with it. Hidden where nothing was live."""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path

from PySide6.QtCore import QObject, Qt
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
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.live.live_controller import LiveController
from bubbleviz_ui.live.recording_control import RecordingState, new_name
from bubbleviz_ui.model.source_facts import Badge
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.binding import control, watch_controls
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import BarLayout, Elided, fill
from bubbleviz_ui.shell.file_dialogs import remember
from bubbleviz_ui.view3d.render_view import View

# Record button, with what is written so far, markers and notes.


class RecordControls(QWidget):
    """Button, pre-roll, folder; while it records elapsed time, size, messages and a note."""

    def __init__(self, live: LiveController) -> None:
        super().__init__()
        self._live = live
        self.button = QToolButton()
        self.button.setText("● Record")
        self.button.setCheckable(True)
        self.button.setToolTip("Record (Ctrl+R)")
        self.pre_roll = control(live.state, "pre_roll_s")
        self.pre_roll.setPrefix(f"{self.pre_roll.accessibleName()} ")
        self.folder = QToolButton()
        self.folder.setText("Folder…")
        self.progress = Elided(Qt.TextElideMode.ElideRight, "88:88 · 888.8 MB …")
        self.note = QLineEdit()
        self.note.setPlaceholderText("Note, with the time you opened it")
        self.note.setMinimumWidth(100)
        self.note.setToolTip("Enter saves the note in the recording")
        self.note.hide()
        self._noted_ns: int | None = None
        fill(
            QHBoxLayout(self),
            self.progress,
            self.note,
            self.pre_roll,
            self.folder,
            self.button,
            margins=(0, 0, 0, 0),
        )
        self.folder.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.button.clicked.connect(live.toggle_recording)
        self.folder.clicked.connect(self.choose_folder)
        self.note.returnPressed.connect(self._save_note)
        self.note.editingFinished.connect(self.note.hide)
        self._show_folder()

    def show_now(self) -> None:
        """Write how the recording is going."""
        state, busy = self._live.recording.state(), self._live.recording.busy
        self._show_folder()
        self.button.setChecked(busy)
        self.button.setText("■ Stop" if busy else "● Record")
        self.button.setToolTip("End the recording (Ctrl+R)" if busy else "Record (Ctrl+R)")
        for widget in (self.pre_roll, self.folder):
            widget.setVisible(not busy)
        self.progress.setVisible(busy)
        text = "" if state is None else progress(state)
        self.progress.setText(text)
        self.progress.setToolTip(text)
        if not busy:
            self.note.hide()

    def begin_note(self) -> None:
        """Write a note about this moment."""
        if self._live.recording.busy:
            self._noted_ns = time.time_ns()
            self.note.clear()
            self.note.show()
            self.note.setFocus()

    def choose_folder(self) -> None:
        """Choose where recordings go."""
        folder = self._live.recording.folder
        present = folder if folder.is_dir() else folder.parent  # it is made with the first
        name = QFileDialog.getExistingDirectory(self, "Record into", str(present))
        if name:
            self._live.choose_folder(name)
            remember("recording", new_name(Path(name)))
            self._show_folder()

    def _save_note(self) -> None:
        text = self.note.text().strip()
        if text:
            self._live.recording.mark(text, self._noted_ns)
        self.note.clearFocus()

    def _show_folder(self) -> None:
        self.folder.setToolTip(f"Recordings go to {self._live.recording.folder}")


def progress(state: RecordingState) -> str:
    """Elapsed time, size, messages and what waits for the disk."""
    minutes, seconds = divmod(int(state.elapsed_s), 60)
    status = state.status
    return (
        f"{minutes:02d}:{seconds:02d} · {status.size_bytes / 1e6:.1f} MB · "
        f"{count_of(status.messages, 'message')} · {status.waiting_bytes / 1e6:.1f} MB waiting"
    )


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
"""Colour of the badge with each word."""

SENSOR_TIP = "Show this sensor in the panels (B: switch sensor)"
RATE_LOOKS = 11
RATE_FROM_S = 0.5
"""The rate is counted over the last looks, once they span this."""

WRONG = {
    "out_of_order": "out of order",
    "duplicate": "duplicate",
    "undecodable": "undecodable",
    "wrong_type": "of wrong type",
    "wrong_size": "of wrong size",
    "bad_stamps": "with bad stamps",
    "clock_jumps": "clock jumps",
    "missed": "lost",
}
"""Counters that are shown once they are not zero."""


class LiveBar(QFrame):
    """What it is and can do, in more rows where it is narrow; below it what was counted."""

    def __init__(self, live: LiveController, units: Units) -> None:
        super().__init__()
        self._live, self._units = live, units
        self.setObjectName("live")
        self.state = QLabel(wordWrap=True)  # why a robot refuses is a whole sentence
        self.sensors: list[QToolButton] = []
        self.record = RecordControls(live)
        self.zero = self._button(
            "Zero gas", "Zero the gas pressure in the next contact-free frames (Ctrl+Shift+G)"
        )
        self.publish = self._button("Publish", "")
        self.publish.setCheckable(True)
        self.publish.setToolTip(
            "Publish patch, force, pose and diagnostics over Zenoh to this computer"
        )
        self.leave = self._button("Disconnect", "Disconnect from the source (Ctrl+Shift+L)")
        self.counts = Elided(Qt.TextElideMode.ElideRight)
        self.counts.setObjectName("dim")
        self._lay_out()
        self._connect()
        watch_controls(self)
        self.show_all()

    def show_all(self) -> None:
        """Another session is connected, or none; another source is open."""
        run, waits = self._live.run, self._live.connection is not None
        left = self._live.state.badge == "disconnected"
        self.setVisible(run is not None or waits or left)
        for widget in (self.record, self.zero, self.publish, self.counts):
            widget.setVisible(run is not None)
        self.leave.setVisible(run is not None or waits)
        self.leave.setText("Disconnect" if run is not None else "Cancel")
        self._make_sensors()
        self._counted = None
        self.show_now()

    def show_now(self) -> None:
        """Write how everything is doing now."""
        live = self._live
        if live.sensor is None:
            if live.connection is not None:
                self._say("connecting", live.connection.text())
            else:
                self._say(live.state.badge)
            return
        self.record.show_now()
        status, counters = live.sensor.stream.status(), live.sensor.stream.counters
        drawn = live.connection_state != "connecting"  # until then something else may be open
        badge = live.state.badge if drawn else "connecting"
        self._say(badge, status.silence or self._rate_text(counters.frames))
        self.publish.setChecked(live.publishing.on)
        self._say_doubts()
        counts = "  ·  ".join([self._zero_text(), *counted(counters), *_problem(counters)])
        self.counts.setText(counts)
        self.counts.setToolTip(counts)

    # -- inside -------------------------------------------------------------------------------

    def _button(self, text: str, tip: str) -> QToolButton:
        button = QToolButton()
        button.setText(text)
        button.setToolTip(tip)
        return button

    def _lay_out(self) -> None:
        row, self._both = QWidget(), QWidget()
        self._row = fill(QHBoxLayout(self._both), margins=(0, 0, 0, 0), spacing=6)
        controls = (self._both, self.record, self.zero, self.publish, self.leave)
        BarLayout(row, self.state, *controls, margins=(0, 0, 0, 0))
        fill(QVBoxLayout(self), row, self.counts, margins=(12, 5, 8, 5), spacing=3)

    def _connect(self) -> None:
        live = self._live
        live.changed.connect(self.show_all)
        live.looked.connect(self.show_now)
        live.state.source_changed.connect(self.show_all)
        live.state.frozen_changed.connect(self.show_now)
        live.state.connection_changed.connect(self.show_now)
        self.zero.clicked.connect(live.zero_now)
        self.publish.clicked.connect(live.toggle_publishing)
        self.leave.clicked.connect(live.disconnect_all)

    def _make_sensors(self) -> None:
        """A button for each of two sensors; none for one."""
        run = self._live.run
        places = run.preset.sensors if run is not None and len(run.preset.sensors) > 1 else ()
        while self.sensors:
            button = self.sensors.pop()
            self._row.removeWidget(button)
            button.deleteLater()
        for number, place in enumerate(places):
            button = self._button(f"● {place.name}", SENSOR_TIP)
            button.setStyleSheet(
                f"QToolButton {{ color: {place.colour}; }}"
                f"QToolButton:checked {{ background: {place.colour}; color: black; }}"
            )
            button.setCheckable(True)
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.setChecked(number == self._live.chosen)
            button.clicked.connect(lambda _=False, number=number: self._live.choose(number))
            self._row.addWidget(button)
            self.sensors.append(button)
        self._both.setVisible(bool(self.sensors))

    def _say_doubts(self) -> None:
        """Which of two sensors is not to be trusted: the readout is of the chosen one alone."""
        run = self._live.run
        if run is None:
            return
        for number, button in enumerate(self.sensors):
            name, doubt = run.preset.sensors[number].name, self._live.doubt_about(number)
            button.setText(f"● {name}: {doubt.partition(':')[0]}" if doubt else f"● {name}")
            button.setToolTip(doubt or SENSOR_TIP)

    def _say(self, badge: Badge, text: str = "") -> None:
        colours = f"background-color:{BADGES[badge]}; color:{theme.ON_BADGE}" if badge else ""
        self.state.setText(f'<b style="{colours}">&nbsp;{badge}&nbsp;</b>&nbsp; {text}')

    def _rate_text(self, frames: int) -> str:
        """The rate at which images come; empty until it is known."""
        now = time.monotonic()
        if self._counted is None or frames < self._counted[-1][1]:
            self._counted = deque([(now, frames)], maxlen=RATE_LOOKS)
        self._counted.append((now, frames))
        then, before = self._counted[0]
        if now - then < RATE_FROM_S:
            return ""
        return self._units.rate.text((frames - before) / (now - then))

    _counted: deque[tuple[float, int]] | None = None

    def _zero_text(self) -> str:
        sensor = self._live.sensor
        if sensor is None or (sensor.zero.waiting and sensor.zero.offset_pa is None):
            return "gas pressure not zeroed yet"
        offset = self._units.gas_pressure.text(sensor.zero.offset_pa, signed=True)
        return f"gas zero {offset}" + (
            ", waiting for contact-free frames" if sensor.zero.waiting else ""
        )


def counted(counters: Counters) -> list[str]:
    """What was counted, in words: what came, and what was wrong with it where something was."""
    words = [
        count_of(counters.received, "message"),
        count_of(counters.frames, "image"),
        f"{counters.skipped} skipped",
    ]
    for name, word in WRONG.items():
        count = getattr(counters, name)
        if count:
            words.append(f"{count} {word}")
    return words


def _problem(counters: Counters) -> list[str]:
    return [counters.problem] if counters.problem else []


# How old a live frame is when its picture is on the screen.


class PictureAge(QObject):
    """Measures from stamp to picture; from the arrival where the robot has another clock."""

    def __init__(self, controller: Controller, view: View) -> None:
        super().__init__()
        self._shown: Frame | None = None
        self._meter = LatencyMeter()
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        view.rendered.connect(self._on_rendered)

    def begin(self, pictures: int = 600) -> None:
        """Forget what was measured; from now on the last so many pictures count."""
        self._shown, self._meter = None, LatencyMeter(pictures)

    def _on_opened(self, _: object) -> None:
        self.begin()

    @property
    def ages_s(self) -> list[float]:
        """Age of each picture that counts, s."""
        return self._meter.ages_s

    def report(self) -> LatencyReport | None:
        """Ages of the last pictures; None where none was live."""
        return self._meter.report()

    def _on_shown(self, result: Result) -> None:
        fresh = result.frame.arrival_ns > 0 and result.frame is not self._shown
        self._shown = result.frame if fresh else None

    def _on_rendered(self) -> None:
        frame, self._shown = self._shown, None
        if frame is not None:
            self._meter.add(frame, time.time_ns())
