"""Playback panel: timeline, playback controls, current frame and time."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QHBoxLayout,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import SPEEDS, Settings
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.playback.timeline import Timeline
from bubbleviz_ui.shell.binding import bind, control
from bubbleviz_ui.shell.dock import Steady, fill, tool_button

PLAY, PAUSE = "▶", "▮▮"
TIMELINE_EVERY_MS = 200
"""Period of timeline repaints for new numbers during playback, and for new frames at its end."""
SECOND_STEPS = {
    -1.0: ("−1", "Ctrl+←"),
    -0.1: ("−0.1", "Shift+←"),
    0.1: ("+0.1", "Shift+→"),
    1.0: ("+1", "Ctrl+→"),
}
"""Label and keys of each step in s."""
SWITCHES = {
    "Loop": Settings.info("loop").tip,
    "Mark": "Mark or unmark this frame (M); PgUp, PgDn go to marked frames",
    "Freeze": "Keep showing this frame while the live source continues (F)",
}
MARGIN, SPACING = 10, 4
"""Margins of the button row, and distance between widgets, screen pixels."""


def next_speed(speed: float, direction: int) -> float:
    """The next faster (1) or slower (-1) playback speed."""
    return SPEEDS[min(max(SPEEDS.index(speed) + direction, 0), len(SPEEDS) - 1)]


class PlaybackPanel(QWidget):
    """Timeline, playback controls, and a readout of frame and time."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.first = tool_button("▮◀", "First frame (Home)", lambda: state.seek(0))
        self.back = tool_button("◂", "Previous frame (←)", lambda: state.step(-1))
        self.play = tool_button(
            PAUSE, "Play or pause (Space)", lambda: state.set_playing(not state.playing)
        )
        self.forward = tool_button("▸", "Next frame (→)", lambda: state.step(1))
        self.last = tool_button("▶▮", "Last frame (End)", state.seek_last)
        self.second_steps = {seconds: self._step_button(seconds) for seconds in SECOND_STEPS}
        self.timeline = Timeline(state)
        self._repaint = Throttle(self, lambda: self.timeline.update(), TIMELINE_EVERY_MS)
        self.readout = Steady()
        self.speed, self.mode = control(state, "speed"), control(state, "every_frame")
        self.loop, self.mark, self.freeze = (
            tool_button(text, tip, checkable=True) for text, tip in SWITCHES.items()
        )
        self.mark.clicked.connect(lambda: state.toggle_marker(state.playhead))
        self.freeze.clicked.connect(state.freeze)
        self.go_live = tool_button(
            "Live", "Go live: show the newest frame (N)", lambda: state.freeze(False)
        )
        self._lay_out()
        self._show_all()
        bind(self.loop, state, "loop")
        state.frame_changed.connect(self._on_frame)
        state.history_changed.connect(self._on_history)
        for changed in (state.source_changed, state.settings_changed, state.playing_changed,
                        state.frozen_changed, state.range_changed,
                        state.markers_changed):  # fmt: skip
            changed.connect(self._show_all)

    def _step_button(self, seconds: float) -> QToolButton:
        words, keys = SECOND_STEPS[seconds]
        return tool_button(
            f"{words} s",
            f"{words} seconds ({keys})",
            lambda: self._state.step_seconds(seconds),
        )

    def _lay_out(self) -> None:
        back, on = list(self.second_steps.values())[:2], list(self.second_steps.values())[2:]
        moves = (self.first, *back, self.back, self.play, self.forward, *on, self.last)
        how = (self.mark, self.loop, self.freeze, self.go_live, self.mode, self.speed)
        row = fill(
            QHBoxLayout(), *moves, 1, self.readout, 1, *how, margins=(0, 4, 0, 0), spacing=SPACING
        )
        self._row_widgets: tuple[QWidget, ...] = (*moves, self.readout, *how)
        fill(
            QVBoxLayout(self),
            self.timeline,
            row,
            1,
            margins=(MARGIN, 4, MARGIN, 6),
            spacing=0,
        )
        self.readout.setAlignment(Qt.AlignmentFlag.AlignCenter)

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback:  # else shown when the frame is drawn
            self.show_frame()

    def _on_history(self) -> None:
        self._repaint.request() if self._state.playing else self.show_frame()

    def _show_all(self) -> None:
        facts, live = self._state.facts, False
        self.setEnabled(facts is not None)
        self.play.setText(PAUSE if self._state.playing else PLAY)
        self.freeze.setChecked(self._state.frozen)
        if facts is not None:
            live = facts.live
            widest = self._text(facts.frames - 1)
            self.readout.fix_width(self.fontMetrics().horizontalAdvance(widest) + 4)
        self.freeze.setVisible(live and not self._state.frozen)
        self.go_live.setVisible(live and self._state.frozen)
        self._fit()
        self.show_frame()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Hide widgets that do not fit."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        """In a narrow window hide the steps, then the readout; keys and status bar remain."""
        jumps = tuple(self.second_steps.values())
        leaving = (*jumps, self.readout)
        others = [w for w in self._row_widgets if w not in leaving and not w.isHidden()]
        needed = _width(others) + 2 * MARGIN
        self.setMinimumWidth(needed)
        needed += _width([self.readout])
        self.readout.setVisible(self.width() >= needed)
        for button in jumps:
            button.setVisible(self.width() >= needed + _width(jumps))

    def show_frame(self) -> None:
        """Show the current frame; during playback the one drawn."""
        at_end = self._state.grows and self._state.advancing
        self._repaint.request() if at_end else self.timeline.update()
        self.mark.setChecked(self._state.playhead in self._state.markers)
        self.readout.setText(self._text(self._state.playhead))

    def _text(self, frame: int) -> str:
        facts = self._state.facts
        return "" if facts is None else facts.frame_text(frame, self._state.units, "   ")


def _width(widgets: Sequence[QWidget]) -> int:
    """Total width of widgets in a row, screen pixels."""
    return sum(max(w.sizeHint().width(), w.minimumWidth()) + SPACING for w in widgets)
