"""Keys and wheel of a panel's controls.

A control reached by Tab keeps its own keys; else they play and seek. One without the focus leaves
the wheel to what scrolls the panel: a setting must not change because somebody scrolled past it.
"""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QKeyEvent, QKeySequence
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QSlider,
    QWidget,
)

BUTTON_KEYS = frozenset({Qt.Key.Key_Space})
STEPPED = (QAbstractSpinBox, QSlider, QComboBox)
"""Controls whose value the wheel changes."""
SLIDER_KEYS = frozenset({Qt.Key.Key_Left, Qt.Key.Key_Right, Qt.Key.Key_Home, Qt.Key.Key_End})


class ControlInput(QObject):
    """Event filter: focused controls get their keys before shortcuts do, others leave the wheel."""

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Claim the keys that the watched control understands, and refuse a wheel without focus."""
        if event.type() == QEvent.Type.Wheel and isinstance(watched, STEPPED):
            event.setAccepted(watched.hasFocus())
            return not watched.hasFocus()
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


def watch_controls(panel: QWidget) -> None:
    """Let every control of a panel be reached by Tab, and settings be changed on purpose alone.

    Buttons, sliders and choices do not take the focus on a click, number boxes not from the wheel.
    """
    control_input = ControlInput(panel)
    for kind in (QAbstractButton, QSlider, QComboBox):
        for widget in panel.findChildren(kind):
            widget.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            widget.installEventFilter(control_input)
    for box in panel.findChildren(QAbstractSpinBox):
        box.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        box.installEventFilter(control_input)
    for line in panel.findChildren(QLineEdit):
        line.installEventFilter(control_input)
