"""The session model: what is open, where the cursor is, what the user chose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from PySide6.QtCore import QObject, Signal

from bubbleviz.diagnostics import Numbers
from bubbleviz_ui.model.choices import PATCH_CHOICES, Choices
from bubbleviz_ui.model.frame_history import History
from bubbleviz_ui.model.source_facts import Badge, Link, SourceFacts
from bubbleviz_ui.model.units import SYSTEMS, Units


class SessionState(QObject):
    """Single place where the window's state lives; a signal tells each change of it."""

    source_changed = Signal(object)  # Another source or sensor is open: its `SourceFacts`
    # The cursor moved: the frame, and whether playback moved it or a person
    frame_changed = Signal(int, bool)
    # playing_changed, frozen_changed: Playback started or stopped; the view of a live source stands
    # still or goes on
    playing_changed = Signal(bool)
    frozen_changed = Signal(bool)
    link_changed = Signal()  # What is connected is doing otherwise
    # The user chose something: the names of the fields of `Choices` that differ, a frozenset
    choices_changed = Signal(object)
    # range_changed, markers_changed: Another range is played; other frames are marked
    range_changed = Signal()
    markers_changed = Signal()
    history_changed = Signal()  # More is known of some frames, or less

    def __init__(self, choices: Choices | None = None) -> None:
        super().__init__()
        self.choices = choices or Choices()
        self.facts: SourceFacts | None = None  # None until a source is open
        # frame: Cursor: the frame the user wants to see
        self.frame = self.shown = 0
        self.playing = False
        self.frozen = False  # The cursor stays while the live source goes on
        # One in so many points of the cloud is shown while frames follow each other
        self.thinned = 1
        self.link: Link = "disconnected"  # How what is connected is doing
        self.now = 0  # Frame a live source is at
        self.play_range: tuple[int, int] | None = None  # First and last frame to play; None for all
        self.markers: tuple[int, ...] = ()  # Marked frames, in order
        self.history = History(0)  # What was computed so far
        self.units = Units()
        self.units.use({name: getattr(self.choices, name) for name in SYSTEMS})

    def open(
        self,
        facts: SourceFacts,
        frame: int = 0,
        *,
        playing: bool,
        history: History | None = None,
    ) -> None:
        """Change to another source: choices stay, the cursor goes to `frame`."""
        if self.facts is None or not self.facts.same_source(facts):
            self.play_range = None
            self.markers = tuple(sorted({frame for frame, _ in facts.marks}))
        self.facts = facts
        self.history = History(facts.frames) if history is None else history
        self.frame = self.shown = self.now = min(max(frame, 0), facts.frames - 1)
        self.frozen = False
        self.source_changed.emit(facts)
        self.set_playing(playing)

    @property
    def playhead(self) -> int:
        """The frame to point at and to mark: the cursor, while playing the one in the picture."""
        return self.shown if self.playing and not self.frozen else self.frame

    def seek(self, index: int, *, by_playback: bool = False) -> None:
        """Move the cursor, held inside the recording; a live source goes on without it."""
        if self.facts is None:
            return
        if self.facts.live and self.playing and not by_playback:
            self.freeze(True)
        index = min(max(index, 0), self.facts.frames - 1)
        if index == self.frame:
            return
        self.frame = index
        self.frame_changed.emit(index, by_playback)

    def step(self, frames: int) -> None:
        """Stop playing and move the cursor by a number of frames."""
        if self.facts is not None and not self.facts.live:
            self.set_playing(False)
        self.seek(self.frame + frames)

    def jump(self, seconds: float) -> None:
        """Stop playing and move the cursor by a time, by one frame at least."""
        if self.facts is None:
            return
        times = self.facts.times_s
        nearest = int(np.abs(times - (times[self.frame] + seconds)).argmin())
        away = nearest - self.frame
        self.step(away if away * seconds > 0 else int(np.sign(seconds)))

    def grow(self, facts: SourceFacts) -> None:
        """Take the facts of a live source that has one more frame, and go on to that."""
        self.facts = facts
        self.go_on(facts.frames - 1)

    def go_on(self, index: int) -> None:
        """Take the frame that playback, or a live source, is at now."""
        self.now = index
        if not self.frozen:
            self.seek(index, by_playback=True)

    def freeze(self, frozen: bool) -> None:
        """Let a live source go on unseen, or come back to now."""
        if self.facts is None or not self.facts.live or frozen == self.frozen:
            return
        self.frozen = frozen
        self.frozen_changed.emit(frozen)
        if not frozen:
            self.seek(self.now, by_playback=True)

    @property
    def badge(self) -> Badge:
        """What one looks at, in one word; empty for a recording, or nothing."""
        facts = self.facts
        return "" if facts is None else facts.badge(self.link, frozen=self.frozen)

    def set_link(self, link: Link) -> None:
        """Take how what is connected is doing."""
        if link != self.link:
            self.link = link
            self.link_changed.emit()

    def choose_range(self, frames: tuple[int, int] | None) -> None:
        """Play only from one frame to another."""
        if frames is not None and self.facts is not None:
            first, last = sorted(min(max(k, 0), self.facts.frames - 1) for k in frames)
            frames = (first, last) if first < last else None
        if frames != self.play_range:
            self.play_range = frames
            self.range_changed.emit()

    def toggle_marker(self, frame: int) -> None:
        """Mark a frame, or take its mark away."""
        self.choose_markers(tuple(sorted(set(self.markers) ^ {frame})))

    def choose_markers(self, frames: tuple[int, ...]) -> None:
        """Mark these frames, in order, and no others."""
        self.markers = frames
        self.markers_changed.emit()

    def seek_marker(self, direction: int) -> None:
        """Go to the next marker (1) or the one before (-1)."""
        ahead = [k for k in self.markers if (k - self.frame) * direction > 0]
        if ahead:
            self.step(min(ahead, key=lambda k: abs(k - self.frame)) - self.frame)

    def remember(
        self, frames: Sequence[int], numbers: Sequence[Numbers], *, same_patch: bool
    ) -> None:
        """Keep what was computed of some frames; of the patch only where it is the present one."""
        for frame, known in zip(frames, numbers, strict=True):
            self.history.take(frame, known, patch=same_patch)
        self.history_changed.emit()

    def set_playing(self, playing: bool) -> None:
        """Start or stop playback; starting at the end begins at the first frame."""
        if self.facts is None or playing == self.playing:
            return
        first, last = self.play_range or (0, self.facts.frames - 1)
        outside = not first <= self.frame <= last
        over = outside or (not self.choices.loop and self.frame == last)
        if playing and over and not self.facts.grows:
            self.seek(first)
        self.playing = playing
        self.playing_changed.emit(playing)

    def choose(self, **changes: Any) -> None:
        """Change choices by name; `choices_changed` tells which ones differ.

        A setting of Compare that is in use brings its κ when that is another.
        """
        before, new = self.choices.used, replace(self.choices, **changes)
        if before and new.used and new.used.kappa not in (None, before.kappa):
            new = replace(new, **{"kappa": new.used.kappa, **changes})
        names = frozenset(
            f.name for f in fields(new) if getattr(new, f.name) != getattr(self.choices, f.name)
        )
        if names:
            self.choices = new
            self.units.use({name: getattr(new, name) for name in names & SYSTEMS.keys()})
            if names & PATCH_CHOICES:
                self.history.forget_patches()
            self.choices_changed.emit(names)

    def choose_layer(self, name: str, visible: bool) -> None:
        """Show or hide a 3-D layer."""
        layers = self.choices.layers
        self.choose(layers=layers | {name} if visible else layers - {name})

    def choose_panel(self, name: str, visible: bool) -> None:
        """Note that a panel that shows results is open or closed."""
        panels = self.choices.panels
        self.choose(panels=panels | {name} if visible else panels - {name})
