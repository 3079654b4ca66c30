"""Undo: a setting goes from one value to another and back, whatever it is a setting of."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication, QUndoCommand, QUndoStack

from ui.state import (
    ChoicesChanged,
    Event,
    MarkersChanged,
    RangeChanged,
    SessionState,
    SourceChanged,
)

T = TypeVar("T")

GESTURE_S = 0.7
"""Changes of one number that follow each other faster are one step, as with a held mouse button."""
LAYOUT = frozenset({"panels"})
"""Choices that follow from what is open; windows are closed and opened, not undone."""
WORDS = {
    "kappa": "κ",
    "every_frame": "every frame",
    "pressure_max_pa": "pressure range",
    "residual_max_m": "residual range",
    "view_from": "scene",
}

_MERGEABLE = 1  # what Qt asks by before it offers two commands to `mergeWith`


class Change(QUndoCommand, Generic[T]):
    """A value that changes from `old` to `new`.

    Parameters
    ----------
    text : str
        What the Edit menu calls it.
    apply : callable
        Makes a value the present one.
    old, new
        Values, immutable.
    gesture : hashable, optional
        Changes of one gesture (a slider that is dragged) are undone as one.
    """

    def __init__(
        self,
        text: str,
        apply: Callable[[T], None],
        old: T,
        new: T,
        gesture: Hashable = None,
    ) -> None:
        super().__init__(text)
        self.apply, self.old, self.new, self.gesture = apply, old, new, gesture

    def id(self) -> int:
        """Same for all that may be merged."""
        return -1 if self.gesture is None else _MERGEABLE

    def mergeWith(self, other: QUndoCommand) -> bool:
        """Take over what a later change of the same gesture leads to."""
        if not isinstance(other, Change) or other.gesture != self.gesture:
            return False
        self.new = other.new
        return True

    def undo(self) -> None:
        """Go back."""
        self.apply(self.old)

    def redo(self) -> None:
        """Do it, for the first time or again."""
        self.apply(self.new)


class SettingsHistory:
    """Puts every setting the user changes on the stack: choices, played range, markers.

    Parameters
    ----------
    state : SessionState
    stack : QUndoStack
    """

    def __init__(self, state: SessionState, stack: QUndoStack) -> None:
        self._state, self._stack = state, stack
        self._quiet = False
        self._gesture, self._changed_s = 0, 0.0
        self._take_all()
        state.subscribe(self._on_event)

    @contextmanager
    def unrecorded(self) -> Iterator[None]:
        """Changes in here are nobody's steps."""
        before, self._quiet = self._quiet, True
        try:
            yield
        finally:
            self._quiet = before
            self._take_all()

    def _take_all(self) -> None:
        state = self._state
        self._choices = state.choices
        self._range, self._markers = state.play_range, state.markers

    def _on_event(self, event: Event) -> None:
        if not self._quiet:
            if isinstance(event, ChoicesChanged):
                self._on_choices(event.names - LAYOUT)
            elif isinstance(event, RangeChanged):
                self._push("range", self._state.choose_range, self._range, event.frames)
            elif isinstance(event, MarkersChanged):
                self._push("marker", self._state.choose_markers, self._markers, event.frames)
        if isinstance(event, ChoicesChanged | RangeChanged | MarkersChanged | SourceChanged):
            self._take_all()

    def _on_choices(self, names: frozenset[str]) -> None:
        if not names:
            return
        old = {name: getattr(self._choices, name) for name in names}
        new = {name: getattr(self._state.choices, name) for name in names}
        text = "scene" if "view_from" in names else next(iter(sorted(names)))
        numbers = [v for v in (*old.values(), *new.values()) if not isinstance(v, bool)]
        drags = len(names) == 1 and any(isinstance(v, float) for v in numbers)
        gesture = (names, self._present_gesture()) if drags else None
        self._push(WORDS.get(text, text).replace("_", " "), self._choose, old, new, gesture)

    def _choose(self, values: dict[str, Any]) -> None:
        self._state.choose(**values)

    def _present_gesture(self) -> int:
        now, held = time.monotonic(), QGuiApplication.mouseButtons() != Qt.MouseButton.NoButton
        if not held and now - self._changed_s > GESTURE_S:
            self._gesture += 1
        self._changed_s = now
        return self._gesture

    def _push(
        self, text: str, apply: Callable[[Any], None], old: Any, new: Any, gesture: Hashable = None
    ) -> None:
        def quietly(value: Any) -> None:
            with self.unrecorded():
                apply(value)

        self._stack.push(Change(text, quietly, old, new, gesture))
