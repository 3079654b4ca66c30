"""Undo and redo of everything the user can set."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

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


class _Watched(NamedTuple):
    """A watched value."""

    value: Callable[[], Any]
    apply: Callable[[Any], None]
    continuous: bool


class UndoRecorder:
    """Watches everything that can be set, and pushes changes onto the undo stack."""

    def __init__(self, state: SessionState, stack: QUndoStack) -> None:
        self.stack, self._state = stack, state
        self._suspended = 0
        self._gesture, self._changed_s = 0, 0.0
        self._parts: dict[str, _Watched] = {}  # By their texts
        self._last: dict[str, Any] = {}  # Settings and watched values at the last check
        state.settings_changed.connect(self._record)
        state.source_changed.connect(self._update_last)
        self.watch("range", state.range_changed, lambda: state.play_range, state.set_range)
        self.watch("marker", state.markers_changed, lambda: state.markers, state.set_markers)

    def watch(
        self,
        text: str,  # Name in the Edit menu
        # Emitted when it may have changed; None: the settings change with it
        changed: SignalInstance | None,
        value: Callable[[], Any],
        apply: Callable[[Any], None],  # Sets a value
        *,
        continuous: bool = False,  # A number that may be dragged
    ) -> None:
        """Record changes of a value on the stack."""
        self._parts[text] = _Watched(value, apply, continuous)
        self._update_last()
        if changed is not None:
            changed.connect(self._record)

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
            self._record(text=text)

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

    def gesture(self, what: Hashable) -> Hashable:
        """The present gesture, if it goes on to change the same numbers."""
        now = time.monotonic()
        button_down = QGuiApplication.mouseButtons() != Qt.MouseButton.NoButton
        if not button_down and now - self._changed_s > GESTURE_S:
            self._gesture += 1
        self._changed_s = now
        return what, self._gesture

    def _values(self) -> dict[str, Any]:
        settings = {k: v for k, v in vars(self._state.settings).items() if k not in LAYOUT}
        return settings | {text: part.value() for text, part in self._parts.items()}

    def _update_last(self) -> None:
        self._last = self._values()

    def _record(self, *_: object, text: str = "") -> None:
        """Record all differences since the last check as one step."""
        if self._suspended:
            return
        last, self._last = self._last, self._values()
        names = [name for name, value in self._last.items() if value != last[name]]
        if names:
            old, new = ({name: values[name] for name in names} for values in (last, self._last))
            single = [each for k in names for each in _differences((k,), old[k], new[k])]
            dragged = all(self._may_drag(path[0]) and _are_numbers(*ab) for path, *ab in single)
            gesture = self.gesture(frozenset(path for path, *_ in single)) if dragged else None
            first = names[0]
            if not text and first not in self._parts:
                text = Settings.info(min(old.keys() - self._parts.keys())).label
            self.push(text or first, self._use, old, new, gesture)

    def _may_drag(self, name: str) -> bool:
        return name not in self._parts or self._parts[name].continuous

    def _use(self, values: dict[str, Any]) -> None:
        self._state.change(**{k: v for k, v in values.items() if k not in self._parts})
        for name, part in self._parts.items():
            if name in values:
                part.apply(values[name])


def _differences(path: tuple[Any, ...], old: Any, new: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Paths and values of the single values that differ; those within settings of Compare, too."""
    pairs: list[tuple[Any, Any, Any]] = []
    if path == ("compared",):
        pairs = [(k, *each) for k, each in enumerate(zip(old, new, strict=True))]
    elif isinstance(old, ComparedSetting):
        pairs = [(k, value, getattr(new, k)) for k, value in vars(old).items()]
    elif old != new:
        yield path, old, new
    for name, a, b in pairs:
        yield from _differences((*path, name), a, b)


def _are_numbers(*values: object) -> bool:
    """Whether any is a number or a tuple of numbers; others are None."""
    return any(
        all(map(_are_numbers, value))
        if isinstance(value, tuple)
        else isinstance(value, int | float) and not isinstance(value, bool)
        for value in values
    )
