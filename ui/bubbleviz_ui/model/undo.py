"""Undo: a setting goes from one value to another and back, whatever it is a setting of."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

from PySide6.QtCore import Qt, SignalInstance
from PySide6.QtGui import QGuiApplication, QUndoCommand, QUndoStack
from PySide6.QtWidgets import QWidget

from bubbleviz_ui.model.choices import Choices, Setting
from bubbleviz_ui.model.session_state import SessionState

T = TypeVar("T")

GESTURE_S = 0.7
"""Changes of one number that follow each other faster are one step, as with a held mouse button."""
LAYOUT = frozenset({"panels"})
"""Choices that follow from what is open, which is a step by itself."""

_MERGEABLE = 1  # what Qt asks by before it offers two commands to `mergeWith`


class Change(QUndoCommand, Generic[T]):
    """A value that changes from `old` to `new`."""

    def __init__(
        self,
        text: str,  # What the Edit menu calls it
        apply: Callable[[T], None],  # Makes a value the present one
        old: T,  # old, new: Values, immutable
        new: T,
        # Changes of one gesture (a slider that is dragged) are undone as one
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


@dataclass
class _Watched(Generic[T]):
    """Something that can be changed, and its value when it was looked at last."""

    text: str
    value: Callable[[], T]
    apply: Callable[[T], None]
    last: T


class SettingsHistory:
    """Puts every setting the user changes on the stack: choices, range and markers."""

    def __init__(self, state: SessionState, stack: QUndoStack) -> None:
        self._state, self._stack = state, stack
        self._quiet = False
        self._gesture, self._changed_s = 0, 0.0
        self._choices = state.choices
        self._watched: list[_Watched[Any]] = []
        self.watch("range", state.range_changed, lambda: state.play_range, state.choose_range)
        self.watch("marker", state.markers_changed, lambda: state.markers, state.choose_markers)
        state.choices_changed.connect(self._on_choices)
        state.source_changed.connect(self._take_all)

    def watch(
        self, text: str, changed: SignalInstance, value: Callable[[], T], apply: Callable[[T], None]
    ) -> None:
        """Put changes of something else on the stack, too.

        `text`: What the Edit menu calls it.
        `changed`: Tells that it may have changed.
        `apply`: Makes a value the present one.
        """
        self._watched.append(_Watched(text, value, apply, value()))
        changed.connect(self._on_watched)

    def watch_box(self, text: str, box: QWidget) -> None:
        """Put changes of a box on the stack: of its value, text or tick, whatever the user sets."""
        value = box.metaObject().userProperty()

        def use(new: Any) -> None:
            value.write(box, new)

        changed = getattr(box, value.notifySignal().name().toStdString())
        self.watch(text, changed, lambda: value.read(box), use)

    @contextmanager
    def one_step(self, text: str) -> Iterator[None]:
        """Changes in here are undone together."""
        self._stack.beginMacro(text)
        try:
            yield
        finally:
            self._stack.endMacro()
            step = self._stack.command(self._stack.index() - 1)
            if not step.childCount():
                step.setObsolete(True)  # nothing changed: no step
                self._stack.undo()

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
        self._choices = self._state.choices
        for each in self._watched:
            each.last = each.value()

    def _on_watched(self) -> None:
        for each in self._watched:
            old, each.last = each.last, each.value()
            if not self._quiet and each.last != old:
                number = isinstance(old, int | float) and not isinstance(old, bool)
                gesture = (each.text, self._present_gesture()) if number else None
                self.push(each.text, each.apply, old, each.last, gesture)

    def _on_choices(self, names: frozenset[str]) -> None:
        before, self._choices = self._choices, self._state.choices
        names -= LAYOUT
        if self._quiet or not names:
            return
        old = {name: getattr(before, name) for name in names}
        new = {name: getattr(self._state.choices, name) for name in names}
        text = Choices.about("view_from" if "view_from" in names else min(names)).label
        drags = len(names) == 1 and any(map(_is_dragged, (*old.values(), *new.values())))
        part: Hashable = names if drags else None
        if "compared" in names and names <= {"compared", "kappa"}:  # κ comes with what is in use
            part = _number_compared(before.compared, self._state.choices.compared)
        gesture = None if part is None else (part, self._present_gesture())
        self.push(text, self._choose, old, new, gesture)

    def _choose(self, values: dict[str, Any]) -> None:
        self._state.choose(**values)

    def _present_gesture(self) -> int:
        now, held = time.monotonic(), QGuiApplication.mouseButtons() != Qt.MouseButton.NoButton
        if not held and now - self._changed_s > GESTURE_S:
            self._gesture += 1
        self._changed_s = now
        return self._gesture

    def push(
        self, text: str, apply: Callable[[Any], None], old: Any, new: Any, gesture: Hashable = None
    ) -> None:
        """Make a value the present one, as a step of its own; see `Change`."""

        def quietly(value: Any) -> None:
            with self.unrecorded():
                apply(value)

        self._stack.push(Change(text, quietly, old, new, gesture))


def _number_compared(old: Sequence[Setting], new: Sequence[Setting]) -> Hashable:
    """Which number of which setting differs; None where it is a name, or more than one."""
    pairs = [
        (number, field.name, getattr(a, field.name), getattr(b, field.name))
        for number, (a, b) in enumerate(zip(old, new, strict=True))
        for field in fields(Setting)
    ]
    parts = [(k, name, a, b) for k, name, a, b in pairs if a != b]
    number, name, a, b = parts[0]
    return (number, name) if len(parts) == 1 and not isinstance(a or b, str) else None


def _is_dragged(value: object) -> bool:
    """A number, or some of them: what sliders, arrows and the mouse change little by little."""
    if isinstance(value, tuple):
        return all(isinstance(each, int | float) for each in value)
    return isinstance(value, float)
