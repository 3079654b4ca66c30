"""Playback: which frame of a recording is due, by the clock or one after the other."""

from __future__ import annotations

import time

from PySide6.QtCore import QObject, Qt, QTimer

from bubbleviz_ui.model.choices import PLAYBACK_CHOICES
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.playback.play_clock import PlayClock

TICK_MS = 8
"""How often playback looks at its clock."""
AHEAD_S = 0.025
"""How early the next frame may be asked for, so that the solver has work while this is drawn."""


class Player(QObject):
    """Moves the cursor while a recording is played; live sources move it by themselves.

    Attributes
    ----------
    skipped : int
        Frames passed by because they were over before they could be asked for.
    """

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.skipped = 0
        self._clock: PlayClock | None = None
        self._read_s = 0.0
        self._came = -1
        self._timer = QTimer(self, timerType=Qt.TimerType.PreciseTimer, interval=TICK_MS)
        self._timer.timeout.connect(lambda: self._tick())
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._on_playing)
        state.source_changed.connect(self._wind)
        state.range_changed.connect(self._wind)
        state.choices_changed.connect(self._on_choices)

    def came(self, frame: int) -> None:
        """A frame is there to be drawn: the next one may be due soon."""
        self._came = frame
        self._tick(AHEAD_S)

    def turn_to(self, frame: int) -> None:
        """Another source is open, and this frame of it is shown."""
        self.skipped, self._came = 0, frame

    def close(self) -> None:
        """Stop the timer."""
        self._timer.stop()

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback and not self._state.frozen:
            self._start()

    def _on_playing(self, playing: bool) -> None:
        self._start()
        facts = self._state.facts
        grows = facts is not None and facts.grows
        self._timer.start() if playing and not grows else self._timer.stop()

    def _wind(self) -> None:
        """Take the times of another source, or another range of them."""
        facts = self._state.facts
        if facts is not None:
            frames = self._state.play_range
            self._clock = None if facts.grows else PlayClock(facts.times_s, frames)
            self._start()

    def _on_choices(self, names: frozenset[str]) -> None:
        if names & PLAYBACK_CHOICES:
            self._start()

    def _start(self) -> None:
        if self._clock is not None:
            self._read_s = 0.0
            frame = self._state.now if self._state.frozen else self._state.frame
            self._clock.start(frame, time.perf_counter(), self._state.choices.speed)

    def _tick(self, ahead_s: float = 0.0) -> None:
        state = self._state
        if self._clock is None or not state.playing:
            return
        now = max(time.perf_counter() + ahead_s, self._read_s)  # never back
        self._read_s = now
        loop = state.choices.loop
        if state.choices.every_frame:
            if self._came != state.frame and not state.frozen:
                return
            index, ended = self._clock.following(now, loop=loop)
        else:
            index, skipped, ended = self._clock.due(now, loop=loop)
            self.skipped += 0 if state.frozen else skipped
        state.go_on(index)
        if ended:
            state.set_playing(False)
