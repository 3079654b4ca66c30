"""Playback panel: timeline, playback controls, current frame and time."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QToolButton, QVBoxLayout, QWidget

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.playback.timeline import Timeline
from bubbleviz_ui.shell.binding import control
from bubbleviz_ui.shell.dock import Steady, fill
from bubbleviz_ui.shell.shortcuts import Shortcuts

PLAY, PAUSE = "▶", "▮▮"
TIMELINE_EVERY_MS = 200
"""Period of timeline repaints for new numbers during playback, and for new frames at its end."""
MOVES = {
    "First frame": "▮◀",
    "1 s back": "−1 s",
    "0.1 s back": "−0.1 s",
    "Previous frame": "◂",
    "Play / pause": PLAY,
    "Next frame": "▸",
    "0.1 s forward": "+0.1 s",
    "1 s forward": "+1 s",
    "Last frame": "▶▮",
}
"""Texts of the buttons at the left, by their actions in the menu."""
MODES = {
    "Mark this frame": "Mark",
    "Loop": "Loop",
    "Freeze a live source": "Freeze",
    "Go live": "Live",
}
"""Those at the right."""
MARGIN, SPACING = 10, 4
"""Margins of the button row, and distance between widgets, screen pixels."""


class PlaybackPanel(QWidget):
    """Timeline, playback controls, and a readout of frame and time."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.buttons = {name: QToolButton() for name in (*MOVES, *MODES)}
        self.timeline = Timeline(state)
        self._repaint = Throttle(self, lambda: self.timeline.update(), TIMELINE_EVERY_MS)
        self.readout = Steady()
        self.speed, self.mode = control(state, "speed"), control(state, "every_frame")
        self._lay_out()
        self._show_all()
        state.frame_changed.connect(self._on_frame)
        state.history_changed.connect(self._on_history)
        for changed in (state.source_changed, state.settings_changed, state.playing_changed,
                        state.frozen_changed, state.range_changed,
                        state.markers_changed):  # fmt: skip
            changed.connect(self._show_all)

    def use_actions(self, shortcuts: Shortcuts) -> None:
        """Give the buttons the function, state and tool tip of the menu's actions."""
        shortcuts.give({button: name for name, button in self.buttons.items()}, "Playback")
        for name, text in {**MOVES, **MODES}.items():
            self.buttons[name].defaultAction().setIconText(text)
        self._show_all()

    def _lay_out(self) -> None:
        moves = [self.buttons[name] for name in MOVES]
        how = (*(self.buttons[name] for name in MODES), self.mode, self.speed)
        row = fill(
            QHBoxLayout(), *moves, 1, self.readout, 1, *how, margins=(0, 4, 0, 0), spacing=SPACING
        )
        self._row_widgets: tuple[QWidget, ...] = (*moves, self.readout, *how)
        fill(QVBoxLayout(self), self.timeline, row, 1, margins=(MARGIN, 4, MARGIN, 6), spacing=0)
        self.readout.setAlignment(Qt.AlignmentFlag.AlignCenter)

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback:  # else shown when the frame is drawn
            self.show_frame()

    def _on_history(self) -> None:
        self._repaint.request() if self._state.playing else self.show_frame()

    def _show_all(self) -> None:
        facts, frozen = self._state.facts, self._state.frozen
        self.setEnabled(not facts.is_empty)
        if (play := self.buttons["Play / pause"].defaultAction()) is not None:
            play.setIconText(PAUSE if self._state.playing else PLAY)
        widest = self._text(facts.frames - 1)
        self.readout.fix_width(self.fontMetrics().horizontalAdvance(widest) + 4)
        self.buttons["Freeze a live source"].setVisible(facts.live and not frozen)
        self.buttons["Go live"].setVisible(facts.live and frozen)
        self._fit()
        self.show_frame()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Hide widgets that do not fit."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        """In a narrow window hide the steps, then the readout; keys and status bar remain."""
        jumps = [button for name, button in self.buttons.items() if " s " in name]
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
        at_end = self._state.facts.grows and self._state.advancing
        self._repaint.request() if at_end else self.timeline.update()
        self.readout.setText(self._text(self._state.playhead))

    def _text(self, frame: int) -> str:
        return self._state.facts.frame_text(frame, self._state.units, "   ")


def _width(widgets: Sequence[QWidget]) -> int:
    """Total width of widgets in a row, screen pixels."""
    return sum(max(w.sizeHint().width(), w.minimumWidth()) + SPACING for w in widgets)
