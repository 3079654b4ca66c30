"""Live bar: how the source is doing, and what one does with it. Hidden where nothing was live."""

from __future__ import annotations

import time
from collections import deque

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QToolButton, QVBoxLayout, QWidget

from bubbleviz.live.counters import Counters
from bubbleviz.wording import count_of
from bubbleviz_ui.live.live_controller import LiveController
from bubbleviz_ui.live.record_controls import RecordControls
from bubbleviz_ui.model.source_facts import Badge
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.control_input import watch_controls
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.layouts import BarLayout, Elided, fill

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

SENSOR_TIP = "The panels show this sensor (B: the other)"
RATE_LOOKS = 11
RATE_FROM_S = 0.5
"""The rate is counted over the last looks, once they span this."""

WRONG = {
    "out_of_order": "out of order",
    "duplicate": "twice",
    "undecodable": "undecodable",
    "wrong_type": "of wrong type",
    "wrong_size": "of wrong size",
    "bad_stamps": "with bad stamps",
    "clock_jumps": "clock jumps",
    "missed": "never arrived",
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
            "Zero gas", "Take the gas pressure's zero from the next rest (Ctrl+Shift+G)"
        )
        self.publish = self._button("Publish", "")
        self.publish.setCheckable(True)
        self.publish.setToolTip("Patch, force, pose and diagnostics over Zenoh, this computer only")
        self.leave = self._button("Disconnect", "Let go of the source (Ctrl+Shift+L)")
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
        status, counters = live.sensor.stream.status(), live.sensor.stream.counters()
        drawn = live.link != "connecting"  # until then something else may be open
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
        live.state.link_changed.connect(self.show_now)
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
        return f"gas zero {offset}" + (", waiting for a rest" if sensor.zero.waiting else "")


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
