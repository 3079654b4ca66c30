"""Playback panel: where we are in time, and the controls to be elsewhere."""

from __future__ import annotations

import time

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QSlider,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from ui.panels.gamma0.strip import RangeStrip
from ui.panels.icons import icon
from ui.panels.keys import keep_keys
from ui.state import (
    ChoicesChanged,
    Event,
    FrameChanged,
    PlayingChanged,
    SessionState,
    SourceChanged,
)

EVERY_S = 0.1
"""While playing: nobody reads faster."""
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


class PlaybackPanel(QWidget):
    """Buttons, seek slider with contact-free ranges, speed, loop, the frame's number and time."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self._shown_at = 0.0
        self.first = self._button("first", "First frame (Home)")
        self.back = self._button("back", "One frame back (←)")
        self.play = self._button("play", "Play or pause (Space)")
        self.forward = self._button("forward", "One frame on (→)")
        self.last = self._button("last", "Last frame (End)")
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setObjectName("seek")
        self.strip = RangeStrip()
        self.strip.hide()
        self.readout = QLabel()
        self.speed = QComboBox()
        for speed in SPEEDS:
            self.speed.addItem(f"{speed:g}×", speed)
        self.speed.setToolTip("Playback speed")
        self.loop = QToolButton()
        self.loop.setText("Loop")
        self.loop.setCheckable(True)
        self.loop.setToolTip("Begin again after the last frame")
        self._lay_out()
        self._show_all()
        self._connect()
        keep_keys(self)
        state.subscribe(self._on_event)

    def _button(self, name: str, tip: str) -> QToolButton:
        button = QToolButton()
        button.setIcon(icon(name))
        button.setToolTip(tip)
        return button

    def _lay_out(self) -> None:
        row = QHBoxLayout(self)
        row.setContentsMargins(10, 8, 10, 8)
        for button in (self.first, self.back, self.play, self.forward, self.last):
            row.addWidget(button)
        timeline = QVBoxLayout()
        timeline.setSpacing(0)
        timeline.addWidget(self.slider)
        timeline.addWidget(self.strip)
        row.addLayout(timeline, 1)
        row.addWidget(self.readout)
        row.addWidget(self.speed)
        row.addWidget(self.loop)
        self.readout.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)

    def _connect(self) -> None:
        state = self._state
        self.first.clicked.connect(lambda: state.seek(0))
        self.last.clicked.connect(lambda: state.seek(state.facts.frames - 1 if state.facts else 0))
        self.back.clicked.connect(lambda: state.step(-1))
        self.forward.clicked.connect(lambda: state.step(1))
        self.play.clicked.connect(lambda: state.set_playing(not state.playing))
        self.slider.valueChanged.connect(state.seek)
        self.speed.currentIndexChanged.connect(
            lambda _: state.choose(speed=self.speed.currentData())
        )
        self.loop.toggled.connect(lambda on: state.choose(loop=on))

    def _on_event(self, event: Event) -> None:
        if isinstance(event, FrameChanged):
            now = time.perf_counter()
            if not event.by_playback or now - self._shown_at >= EVERY_S:
                self._shown_at = now
                self._show_frame()
        elif isinstance(event, PlayingChanged | SourceChanged | ChoicesChanged):
            self._show_all()

    def _show_all(self) -> None:
        facts, choices = self._state.facts, self._state.choices
        self.setEnabled(facts is not None)
        with QSignalBlocker(self.slider):
            self.slider.setRange(0, facts.frames - 1 if facts else 0)
        self.play.setIcon(icon("pause" if self._state.playing else "play"))
        self.speed.setCurrentIndex(self.speed.findData(choices.speed))
        self.loop.setChecked(choices.loop)
        if facts is not None:
            widest = self._text(facts.frames - 1)
            self.readout.setMinimumWidth(self.fontMetrics().horizontalAdvance(widest) + 12)
        self._show_frame()

    def _show_frame(self) -> None:
        with QSignalBlocker(self.slider):
            self.slider.setValue(self._state.frame)
        self.readout.setText(self._text(self._state.frame))

    def _text(self, frame: int) -> str:
        facts = self._state.facts
        if facts is None:
            return ""
        time_text = self._state.units.time.text(float(facts.times_s[frame]))
        return f"frame {frame} / {facts.frames - 1}   {time_text}"
