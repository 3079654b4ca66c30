"""Playback of recordings: in real time, or every frame."""

from __future__ import annotations

import time

import numpy as np
from PySide6.QtCore import QObject, Qt, QTimer

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PLAYBACK_SETTINGS

# Playback time: which frame is due, at a speed, with or without a loop. No Qt.


class PlayClock:
    """Maps wall time to the frame due.

    `times_s`: (F,) array: Time of each frame, s.
    `frames`: First and last frame to play; None: all.
    """

    def __init__(self, times_s: np.ndarray, frames: tuple[int, int] | None = None) -> None:
        times = np.asarray(times_s, dtype=float)
        self._times = times - times[0]
        self._first, self._end = frames or (0, len(times) - 1)
        self._start_s = 0.0
        self._wall_s = 0.0
        self._speed = 1.0
        self._last = 0

    @property
    def period_s(self) -> float:
        """Duration of one loop: time span of the frames plus one mean interval, s."""
        span = float(self._times[self._end] - self._times[self._first])
        return span + (span / (self._end - self._first) if self._end > self._first else 1.0)

    def start(self, index: int, wall_s: float, speed: float) -> None:
        """Start at frame `index`, shown at wall time `wall_s`, at a speed."""
        self._last = min(max(index, self._first), self._end)
        self._start_s = float(self._times[self._last])
        self._wall_s = wall_s
        self._speed = speed

    def due(self, wall_s: float, *, loop: bool) -> tuple[int, int, bool]:
        """Frame due now, frames skipped since the last call, and whether playback has ended."""
        begin, end = float(self._times[self._first]), float(self._times[self._end])
        elapsed = self._start_s + (wall_s - self._wall_s) * self._speed
        ended = not loop and elapsed >= end
        turns, within = divmod(elapsed - begin, self.period_s) if loop else (0.0, elapsed - begin)
        index = int(np.searchsorted(self._times, begin + within + 1e-9, "right")) - 1
        index = self._end if ended else min(max(index, self._first), self._end)
        if turns:
            self._start_s, self._wall_s = begin + within, wall_s
        moved = index + int(turns) * (self._end - self._first + 1) - self._last
        self._last = index
        return index, max(moved - 1, 0), ended

    def next_frame(self, wall_s: float, *, loop: bool) -> tuple[int, bool]:
        """Next frame if it is due, else the last, and whether playback has ended; skips none."""
        if self._last >= self._end:
            if not loop:
                return self._last, True
            index, interval = self._first, self.period_s - self._span(self._first, self._end)
        else:
            index = self._last + 1
            interval = self._span(self._last, index)
        due = self._wall_s + interval / self._speed
        if wall_s < due:
            return self._last, False
        in_time = wall_s - due < interval / self._speed
        self.start(index, due if in_time else wall_s, self._speed)
        return index, False

    def _span(self, first: int, last: int) -> float:
        return float(self._times[last] - self._times[first])


TICK_MS = 8
"""Period of the playback timer."""
REQUEST_AHEAD_S = 0.025
"""How early the next frame is requested, so that it is solved while this one is drawn."""


class Player(QObject):
    """Moves the cursor during playback of a recording; live sources move it themselves."""

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self.skipped = 0  # Frames skipped to keep real time
        self._clock: PlayClock | None = None
        self._clock_s = 0.0
        self._result_frame = -1
        self._timer = QTimer(self, timerType=Qt.TimerType.PreciseTimer, interval=TICK_MS)
        self._timer.timeout.connect(self._tick)
        state.frame_changed.connect(self._on_frame)
        state.playing_changed.connect(self._on_playing)
        state.source_changed.connect(self._make_clock)
        state.range_changed.connect(self._make_clock)
        state.follow(PLAYBACK_SETTINGS, self._start)

    def on_result(self, frame: int) -> None:
        """A frame was solved: request the next one if it is due soon."""
        self._result_frame = frame
        self._tick(REQUEST_AHEAD_S)

    def reset_to(self, frame: int) -> None:
        """Reset for another source, which shows this frame."""
        self.skipped, self._result_frame = 0, frame

    def close(self) -> None:
        """Stop the timer."""
        self._timer.stop()

    def _on_frame(self, _: int, by_playback: bool) -> None:
        if not by_playback and not self._state.frozen:
            self._start()

    def _on_playing(self, playing: bool) -> None:
        self._start()
        self._timer.start() if playing and not self._state.facts.grows else self._timer.stop()

    def _make_clock(self) -> None:
        """Create the clock for another source or range."""
        facts, frames = self._state.facts, self._state.play_range
        self._clock = None if facts.grows else PlayClock(facts.times_s, frames)
        self._start()

    def _start(self) -> None:
        if self._clock is not None:
            self._clock_s = 0.0
            frame = self._state.live_frame if self._state.frozen else self._state.frame
            self._clock.start(frame, time.perf_counter(), self._state.settings.speed)

    def _tick(self, ahead_s: float = 0.0) -> None:
        state = self._state
        if self._clock is None or not state.playing:
            return
        now = max(time.perf_counter() + ahead_s, self._clock_s)  # never backwards
        self._clock_s = now
        loop = state.settings.loop
        if state.settings.every_frame:
            if self._result_frame != state.frame and not state.frozen:
                return
            index, ended = self._clock.next_frame(now, loop=loop)
        else:
            index, skipped, ended = self._clock.due(now, loop=loop)
            self.skipped += 0 if state.frozen else skipped
        state.advance_to(index)
        if ended:
            state.set_playing(False)
