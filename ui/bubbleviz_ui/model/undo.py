"""Undo and redo of everything the user can set."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

from PySide6.QtCore import Qt, SignalInstance
from PySide6.QtGui import QGuiApplication, QUndoCommand, QUndoStack
from PySide6.QtWidgets import QWidget

from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import ComparedSetting, Settings

GESTURE_S = 0.7
"""Faster successive changes of one number are one step, like changes during a mouse drag."""
LAYOUT = frozenset({"panels"})
"""Settings that follow from the open panels, whose change is a step itself."""


class UndoStep(QUndoCommand):
    """A change from `old` to `new` by `apply`; all changes of one gesture are one step."""

    def __init__(
        self,
        history: UndoRecorder,
        text: str,
        apply: Callable[[Any], None],
        old: Any,
        new: Any,
        gesture: Hashable,
    ) -> None:
        super().__init__(text)
        self._history, self.apply = history, apply
        self.old, self.new, self.gesture = old, new, gesture

    def undo(self) -> None:
        """Apply the old value."""
        with self._history.unrecorded():
            self.apply(self.old)

    def redo(self) -> None:
        """Apply the new value, for the first time or again."""
        with self._history.unrecorded():
            self.apply(self.new)


@dataclass
class _Watched:
    """A watched value, and what it was at the last check."""

    text: str
    value: Callable[[], Any]
    apply: Callable[[Any], None]
    continuous: bool
    last: Any


class UndoRecorder:
    """Watches everything that can be set, and pushes changes onto the undo stack."""

    def __init__(self, state: SessionState, stack: QUndoStack) -> None:
        self.stack = stack
        self._suspended = 0
        self._gesture, self._changed_s = 0, 0.0
        self._parts: list[_Watched] = []

        def change(values: dict[str, Any]) -> None:
            state.change(**values)

        self.watch("", state.settings_changed, lambda: state.settings, change, continuous=True)
        self.watch("range", state.range_changed, lambda: state.play_range, state.set_range)
        self.watch("marker", state.markers_changed, lambda: state.markers, state.set_markers)
        state.source_changed.connect(self._update_last)

    def watch(
        self,
        text: str,  # Name in the Edit menu
        # Emitted when it may have changed; None: the settings change with it
        changed: SignalInstance | None,
        value: Callable[[], Any],
        apply: Callable[[Any], None],  # Sets a value
        *,
        continuous: bool = False,  # Contains numbers that may be dragged
    ) -> None:
        """Record changes of a value on the stack."""
        self._parts.append(_Watched(text, value, apply, continuous, value()))
        if changed is not None:
            changed.connect(self._on_changed)

    def _on_changed(self, *_: object) -> None:
        self._record()

    def watch_box(self, text: str, box: QWidget) -> None:
        """Record changes of a widget's value, text or check mark on the stack."""
        value = box.metaObject().userProperty()

        def use(new: Any) -> None:
            value.write(box, new)

        changed = getattr(box, value.notifySignal().name().toStdString())
        self.watch(text, changed, lambda: value.read(box), use, continuous=True)

    @contextmanager
    def one_step(self, text: str) -> Iterator[None]:
        """Changes within this context are one undo step."""
        self._suspended += 1
        try:
            yield
        finally:
            self._suspended -= 1
            self._record(text)

    @contextmanager
    def unrecorded(self) -> Iterator[None]:
        """Changes within this context are not recorded."""
        self._suspended += 1
        try:
            yield
        finally:
            self._suspended -= 1
            self._update_last()

    def push(
        self, text: str, apply: Callable[[Any], None], old: Any, new: Any, gesture: Hashable = None
    ) -> None:
        """Set a value as an undo step, or as part of the last step if that is of its gesture."""
        last = self.stack.command(self.stack.index() - 1)
        goes_on = gesture is not None and not self.stack.canRedo()
        if goes_on and isinstance(last, UndoStep) and last.gesture == gesture:
            # not by Qt's `mergeWith`: PySide would keep the Python object of each merged step
            last.new = new
            last.redo()
        else:
            self.stack.push(UndoStep(self, text, apply, old, new, gesture))

    def _update_last(self) -> None:
        for part in self._parts:
            part.last = part.value()

    def _record(self, text: str = "") -> None:
        """Record all differences since the last check as one step."""
        if self._suspended:
            return
        before, after = dict[int, Any](), dict[int, Any]()
        for number, part in enumerate(self._parts):
            last, part.last = part.last, part.value()
            old, new = _changed_fields(last, part.last)
            if old != new:
                before[number], after[number] = old, new
        if before:
            name = text or self._text(min(before), before[min(before)])
            self.push(name, self._use, before, after, self._gesture_of(before, after))

    def _text(self, number: int, old: Any) -> str:
        return self._parts[number].text or Settings.info(min(old)).label

    def _use(self, values: dict[int, Any]) -> None:
        for number, value in values.items():
            self._parts[number].apply(value)

    def _gesture_of(self, before: dict[int, Any], after: dict[int, Any]) -> Hashable:
        """Numbers being dragged and the gesture's number; None if anything else has changed."""
        numbers = set[Hashable]()
        for part, old in before.items():
            for path, a, b in _differences((part,), old, after[part]):
                if not (self._parts[part].continuous and (_is_number(a) or _is_number(b))):
                    return None
                numbers.add(path)
        return frozenset(numbers), self._current_gesture()

    def _current_gesture(self) -> int:
        now = time.monotonic()
        button_down = QGuiApplication.mouseButtons() != Qt.MouseButton.NoButton
        if not button_down and now - self._changed_s > GESTURE_S:
            self._gesture += 1
        self._changed_s = now
        return self._gesture


def _changed_fields(old: Any, new: Any) -> tuple[Any, Any]:
    """Old and new value; of settings only the changed fields, as others may change unrecorded."""
    if not isinstance(old, Settings):
        return old, new
    names = [f.name for f in fields(old) if getattr(old, f.name) != getattr(new, f.name)]
    before, after = ({k: getattr(one, k) for k in names if k not in LAYOUT} for one in (old, new))
    return before, after


def _differences(path: tuple[Any, ...], old: Any, new: Any) -> Iterator[tuple[Hashable, Any, Any]]:
    """Paths and values of the single values that differ."""
    if isinstance(old, ComparedSetting):
        old, new = vars(old), vars(new)
    elif isinstance(old, tuple) and any(isinstance(each, ComparedSetting) for each in old):
        old, new = dict(enumerate(old)), dict(enumerate(new))
    if isinstance(old, dict):
        for name in old.keys() | new.keys():
            yield from _differences((*path, name), old.get(name), new.get(name))
    elif old != new:
        yield path, old, new


def _is_number(value: object) -> bool:
    """Whether it is a number or a tuple of numbers."""
    if isinstance(value, tuple):
        return all(map(_is_number, value))
    return isinstance(value, int | float) and not isinstance(value, bool)
