"""Undo: a step is what was set before, whatever it is a setting of."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

from PySide6.QtCore import Qt, SignalInstance
from PySide6.QtGui import QGuiApplication, QUndoCommand, QUndoStack
from PySide6.QtWidgets import QWidget

from bubbleviz_ui.model.choices import Choices, Setting
from bubbleviz_ui.model.session_state import SessionState

GESTURE_S = 0.7
"""Changes of one number that follow each other faster are one step, as with a held mouse button."""
LAYOUT = frozenset({"panels"})
"""Choices that follow from what is open, which is a step by itself."""

_MERGEABLE = 1  # what Qt asks by before it offers two commands to `mergeWith`


class Step(QUndoCommand):
    """A change from `old` to `new`, made present by `apply`; steps of one gesture become one."""

    def __init__(
        self,
        history: SettingsHistory,
        text: str,
        apply: Callable[[Any], None],
        old: Any,
        new: Any,
        gesture: Hashable,
    ) -> None:
        super().__init__(text)
        self._history, self.apply = history, apply
        self.old, self.new, self.gesture = old, new, gesture

    def id(self) -> int:
        """Same for all that may be merged."""
        return -1 if self.gesture is None else _MERGEABLE

    def mergeWith(self, other: QUndoCommand) -> bool:
        """Take over what a later change of the same gesture leads to."""
        if not isinstance(other, Step) or other.gesture != self.gesture:
            return False
        self.new = other.new
        return True

    def undo(self) -> None:
        """Go back."""
        with self._history.unrecorded():
            self.apply(self.old)

    def redo(self) -> None:
        """Do it, for the first time or again."""
        with self._history.unrecorded():
            self.apply(self.new)


@dataclass
class _Part:
    """Settings that are kept together, as they were when they were looked at last."""

    text: str
    value: Callable[[], Any]
    apply: Callable[[Any], None]
    drags: bool
    last: Any


class SettingsHistory:
    """Watches everything that can be set, and puts what differs on the stack."""

    def __init__(self, state: SessionState, stack: QUndoStack) -> None:
        self.stack = stack
        self._held = 0
        self._gesture, self._changed_s = 0, 0.0
        self._parts: list[_Part] = []

        def choose(values: dict[str, Any]) -> None:
            state.choose(**values)

        self.watch("", state.choices_changed, lambda: state.choices, choose, drags=True)
        self.watch("range", state.range_changed, lambda: state.play_range, state.choose_range)
        self.watch("marker", state.markers_changed, lambda: state.markers, state.choose_markers)
        state.source_changed.connect(self._take_all)

    def watch(
        self,
        text: str,  # What the Edit menu calls it
        changed: SignalInstance,  # Tells that it may have changed
        value: Callable[[], Any],
        apply: Callable[[Any], None],  # Makes a value the present one
        *,
        drags: bool = False,  # A number, which changes little by little
    ) -> None:
        """Put changes of something on the stack."""
        self._parts.append(_Part(text, value, apply, drags, value()))
        changed.connect(lambda *_: self._look())

    def watch_box(self, text: str, box: QWidget) -> None:
        """Put changes of a box on the stack: of its value, text or tick, whatever the user sets."""
        value = box.metaObject().userProperty()

        def use(new: Any) -> None:
            value.write(box, new)

        changed = getattr(box, value.notifySignal().name().toStdString())
        self.watch(text, changed, lambda: value.read(box), use, drags=True)

    @contextmanager
    def one_step(self, text: str) -> Iterator[None]:
        """Changes in here are undone together."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
            self._look(text)

    @contextmanager
    def unrecorded(self) -> Iterator[None]:
        """Changes in here are nobody's steps."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
            self._take_all()

    def push(
        self, text: str, apply: Callable[[Any], None], old: Any, new: Any, gesture: Hashable = None
    ) -> None:
        """Make a value the present one, as a step of its own."""
        self.stack.push(Step(self, text, apply, old, new, gesture))

    def _take_all(self) -> None:
        for part in self._parts:
            part.last = part.value()

    def _look(self, text: str = "") -> None:
        """Record what differs from the last look as one step."""
        if self._held:
            return
        before, after = dict[int, Any](), dict[int, Any]()
        for number, part in enumerate(self._parts):
            last, part.last = part.last, part.value()
            old, new = _ends(last, part.last)
            if old != new:
                before[number], after[number] = old, new
        if before:
            name = text or self._text(min(before), before[min(before)])
            self.push(name, self._use, before, after, self._gesture_of(before, after))

    def _text(self, number: int, old: Any) -> str:
        return self._parts[number].text or Choices.about(min(old)).label

    def _use(self, values: dict[int, Any]) -> None:
        for number, value in values.items():
            self._parts[number].apply(value)

    def _gesture_of(self, before: dict[int, Any], after: dict[int, Any]) -> Hashable:
        """Which numbers are being dragged; None where anything else has changed."""
        numbers = set[Hashable]()
        for part, old in before.items():
            for path, a, b in _differences((part,), old, after[part]):
                if not (self._parts[part].drags and (_is_number(a) or _is_number(b))):
                    return None
                numbers.add(path)
        return frozenset(numbers), self._present_gesture()

    def _present_gesture(self) -> int:
        now, held = time.monotonic(), QGuiApplication.mouseButtons() != Qt.MouseButton.NoButton
        if not held and now - self._changed_s > GESTURE_S:
            self._gesture += 1
        self._changed_s = now
        return self._gesture


def _ends(old: Any, new: Any) -> tuple[Any, Any]:
    """Of choices only the fields that differ: others may change unrecorded."""
    if not isinstance(old, Choices):
        return old, new
    names = [f.name for f in fields(old) if getattr(old, f.name) != getattr(new, f.name)]
    before, after = ({k: getattr(one, k) for k in names if k not in LAYOUT} for one in (old, new))
    return before, after


def _differences(path: tuple[Any, ...], old: Any, new: Any) -> Iterator[tuple[Hashable, Any, Any]]:
    """Single values that differ, by where they are."""
    if isinstance(old, Setting):
        old, new = vars(old), vars(new)
    elif isinstance(old, tuple) and any(isinstance(each, Setting) for each in old):
        old, new = dict(enumerate(old)), dict(enumerate(new))
    if isinstance(old, dict):
        for name in old.keys() | new.keys():
            yield from _differences((*path, name), old.get(name), new.get(name))
    elif old != new:
        yield path, old, new


def _is_number(value: object) -> bool:
    """A number, or some of them: what sliders, arrows and the mouse change little by little."""
    if isinstance(value, tuple):
        return all(map(_is_number, value))
    return isinstance(value, int | float) and not isinstance(value, bool)
