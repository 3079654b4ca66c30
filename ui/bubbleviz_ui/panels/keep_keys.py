"""Keyboard manners: a widget reached by Tab keeps its own keys, else they play and seek."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QWidget,
)

BUTTON_KEYS = frozenset({Qt.Key.Key_Space})
SLIDER_KEYS = frozenset({Qt.Key.Key_Left, Qt.Key.Key_Right, Qt.Key.Key_Home, Qt.Key.Key_End})


class KeepKeys(QObject):
    """Event filter that claims the keys of focused widgets before shortcuts see them."""

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Accept the override of a key that the watched widget itself understands."""
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            if isinstance(watched, QAbstractSpinBox | QLineEdit):
                return _leaves_to_the_window(event)
            keys = BUTTON_KEYS if isinstance(watched, QAbstractButton) else SLIDER_KEYS
            if event.key() in keys:
                event.accept()
                return True
        return False


def _leaves_to_the_window(event: QKeyEvent) -> bool:
    """Text boxes have an undo of their own, which would hide the window's."""
    undo, redo = QKeySequence.StandardKey.Undo, QKeySequence.StandardKey.Redo
    if event.matches(undo) or event.matches(redo):
        event.ignore()
        return True
    return False


def keep_keys(panel: QWidget) -> None:
    """Let every control of a panel be reached by Tab but not take the focus on a click."""
    key_filter = KeepKeys(panel)
    for kind in (QAbstractButton, QAbstractSlider, QComboBox):
        for widget in panel.findChildren(kind):
            widget.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            widget.installEventFilter(key_filter)
    for text in (QAbstractSpinBox, QLineEdit):
        for box in panel.findChildren(text):
            box.installEventFilter(key_filter)
