"""Model of the session: open source, cursor, playback, settings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Numbers
from bubbleviz_ui.model.frame_history import FrameHistory
from bubbleviz_ui.model.messages import Messages
from bubbleviz_ui.model.registry import PATCH
from bubbleviz_ui.model.settings import PATCH_SETTINGS, Settings
from bubbleviz_ui.model.source_facts import Badge, ConnectionState, SourceFacts
from bubbleviz_ui.model.units import UNIT_CHOICES, Units


class SessionState(QObject):
    """The window's only state; every change emits a signal."""

    source_changed = Signal(object)  # `SourceFacts` of another source or sensor
    frame_changed = Signal(int, bool)  # Frame at the cursor; True if playback moved it
    playing_changed = Signal(bool)
    frozen_changed = Signal(bool)  # The view of a live source was frozen or resumed
    connection_changed = Signal()
    settings_changed = Signal(object)  # Frozenset of the changed field names of `Settings`
    range_changed = Signal()
    markers_changed = Signal()
    history_changed = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.settings = Settings()
        self.messages = Messages(self)
        # not connections, whose references the garbage collection of Python does not see
        self._followers: list[tuple[frozenset[str], Callable[[], object]]] = []
        self.facts = SourceFacts()
        self.frame = self.shown_frame = 0  # Frame at the cursor; frame drawn last
        self.final = True  # Its numbers do not depend on the frames drawn before
        self.playing = False
        self.frozen = False  # The cursor stays while the live source continues
        self.cloud_decimation = 1  # While playing, every n-th point of the cloud is drawn
        self.connection_state: ConnectionState = "disconnected"
        self.live_frame = 0  # Newest frame of a live source
        self.play_range: tuple[int, int] | None = None  # First and last frame to play; None: all
        self.markers: tuple[int, ...] = ()  # Marked frames, ascending
        self.history = FrameHistory(self.facts.frames)
        self.units = Units()

    def open(
        self,
        facts: SourceFacts,
        frame: int = 0,
        *,
        playing: bool,
        history: FrameHistory | None = None,
    ) -> None:
        """Switch to another source at `frame`; settings are kept."""
        if not self.facts.same_source(facts):
            self.play_range = None
            self.markers = tuple(sorted({frame for frame, _ in facts.marks}))
        self.facts = facts
        self.history = FrameHistory(facts.frames) if history is None else history
        self.frame = self.shown_frame = self.live_frame = min(max(frame, 0), facts.frames - 1)
        self.frozen = False
        self.source_changed.emit(facts)
        self.set_playing(playing)

    @property
    def title(self) -> str:
        """Title of the open source; empty if none is open."""
        return "" if self.facts.is_empty else self.facts.title

    @property
    def left_to_analyse(self) -> int:
        """Number of frames of a recording whose patch is not computed yet."""
        whole = self.facts.grows or self.facts.is_empty
        return 0 if whole else len(self.history.missing(PATCH))

    @property
    def advancing(self) -> bool:
        """Whether the frame changes by playback or a live source."""
        return self.playing and not self.frozen

    @property
    def playhead(self) -> int:
        """Frame to mark on the timeline: while playing the frame drawn, else the cursor."""
        return self.shown_frame if self.advancing else self.frame

    def seek(self, index: int, *, by_playback: bool = False) -> None:
        """Move the cursor, clamped to the recording; freezes the view of a live source."""
        if self.facts.live and self.playing and not by_playback:
            self.freeze(True)
        index = min(max(index, 0), self.facts.frames - 1)
        if index == self.frame:
            return
        self.frame = index
        self.frame_changed.emit(index, by_playback)

    def step(self, frames: int) -> None:
        """Stop playing and move the cursor by some frames."""
        if not self.facts.live:
            self.set_playing(False)
        self.seek(self.frame + frames)

    def frame_at(self, time_s: float) -> int:
        """Frame nearest to a time."""
        return int(np.abs(self.facts.times_s - time_s).argmin())

    def step_seconds(self, seconds: float) -> None:
        """Stop playing and move the cursor by some seconds, at least by one frame."""
        away = self.frame_at(self.facts.times_s[self.frame] + seconds) - self.frame
        self.step(away if away * seconds > 0 else int(np.sign(seconds)))

    def grow(self, facts: SourceFacts) -> None:
        """Take the facts of a live source with one more frame, and advance to it."""
        self.facts = facts
        self.advance_to(facts.frames - 1)

    def advance_to(self, index: int) -> None:
        """Move the cursor to the frame of playback or of a live source, unless frozen."""
        self.live_frame = index
        if not self.frozen:
            self.seek(index, by_playback=True)

    def freeze(self, frozen: bool) -> None:
        """Freeze the view of a live source, or return to its newest frame."""
        if not self.facts.live or frozen == self.frozen:
            return
        self.frozen = frozen
        self.frozen_changed.emit(frozen)
        if not frozen:
            self.seek(self.live_frame, by_playback=True)

    @property
    def badge(self) -> Badge:
        """Status of a live source in one word; empty for a recording or no source."""
        return self.facts.badge(self.connection_state, frozen=self.frozen)

    def set_connection(self, connection: ConnectionState) -> None:
        if connection != self.connection_state:
            self.connection_state = connection
            self.connection_changed.emit()

    def set_range(self, frames: tuple[int, int] | None) -> None:
        """Play only the frames from the first to the last one; None: all."""
        if frames is not None:
            first, last = sorted(min(max(k, 0), self.facts.frames - 1) for k in frames)
            frames = (first, last) if first < last else None
        if frames != self.play_range:
            self.play_range = frames
            self.range_changed.emit()

    def toggle_marker(self, frame: int) -> None:
        """Mark a frame, or remove its mark."""
        self.set_markers(tuple(sorted(set(self.markers) ^ {frame})))

    def set_markers(self, frames: tuple[int, ...]) -> None:
        """Replace all markers by these, ascending."""
        self.markers = frames
        self.markers_changed.emit()

    def seek_marker(self, direction: int) -> None:
        """Go to the next marker (1) or the previous one (-1)."""
        ahead = [k for k in self.markers if (k - self.frame) * direction > 0]
        if ahead:
            self.step(min(ahead, key=lambda k: abs(k - self.frame)) - self.frame)

    def remember(
        self, frames: Sequence[int], numbers: Sequence[Numbers], *, same_patch: bool
    ) -> None:
        """Record results of some frames; patch numbers only if κ has not changed since."""
        for frame, known in zip(frames, numbers, strict=True):
            self.history.record(frame, known, patch=same_patch)
        self.history_changed.emit()

    def set_playing(self, playing: bool) -> None:
        """Start or stop playback; started at the end, it begins at the first frame.

        A single frame is not played: it would be solved again and again.
        """
        playing &= self.facts.frames > 1 or self.facts.grows
        if playing == self.playing:
            return
        first, last = self.play_range or (0, self.facts.frames - 1)
        outside = not first <= self.frame <= last
        over = outside or (not self.settings.loop and self.frame == last)
        if playing and over and not self.facts.grows:
            self.seek(first)
        self.playing = playing
        self.playing_changed.emit(playing)

    def follow(self, names: Iterable[str], do: Callable[[], object]) -> None:
        """Call a function after a change of any of these settings."""
        self._followers.append((frozenset(names), do))

    def change(self, **changes: Any) -> None:
        """Change settings by name.

        Switching to a setting of Compare with another κ also changes κ.
        """
        before, new = self.settings.compared_in_use, replace(self.settings, **changes)
        if before and new.compared_in_use and new.compared_in_use.kappa not in (None, before.kappa):
            new = replace(new, **{"kappa": new.compared_in_use.kappa, **changes})
        names = frozenset(
            f.name for f in fields(new) if getattr(new, f.name) != getattr(self.settings, f.name)
        )
        if names:
            self.settings = new
            self.units.use({name: getattr(new, name) for name in names & UNIT_CHOICES.keys()})
            if names & PATCH_SETTINGS:
                self.history.forget_patches()
            self.settings_changed.emit(names)
            for followed, do in () if self.signalsBlocked() else self._followers:
                if names & followed:
                    do()

    def include(self, field: str, name: str, on: bool) -> None:
        """Put a name into a set of names in the settings, such as `layers`, or take it out."""
        names: frozenset[str] = getattr(self.settings, field)
        self.change(**{field: names | {name} if on else names - {name}})
