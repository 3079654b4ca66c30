"""Bars above the view: what went wrong, what one waits for, and how to begin."""

from __future__ import annotations

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import (
    QApplication,
    QFrame,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QWidget,
)

from bubbleviz_ui.shell.layouts import fill

SHOWN_AFTER_MS = 400
"""What is done sooner needs no bar."""
HINT = (
    "Welcome. Drop a recording here or press Ctrl+O; Space plays, ← → go frame by frame. "
    "Ctrl+K finds everything else; hold the mouse over anything to learn what it is."
)


class _Bar(QFrame):
    """A line of text with buttons; hidden while there is nothing to say."""

    def __init__(self, parent: QWidget, name: str, *widgets: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName(name)
        self.label = QLabel(wordWrap=True)
        fill(QHBoxLayout(self), (self.label, 1), *widgets, margins=(12, 6, 8, 6))
        self.hide()


class MessageBar(_Bar):
    """One message at a time."""

    def __init__(self, parent: QWidget) -> None:
        self._details = ""
        self.copy = QPushButton("Copy details")
        self.copy.setToolTip("For a bug report: what went wrong, and where")
        self.dismiss = QPushButton("Dismiss")
        super().__init__(parent, "message", self.copy, self.dismiss)
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._details))
        self.dismiss.clicked.connect(self.hide)

    def say(self, message: str, details: str = "") -> None:
        """Show a message; details can be copied for a bug report."""
        self.label.setText(message)
        self._details = f"{message}\n{details}"
        self.copy.setVisible(bool(details))
        self.show()


class BusyBar(_Bar):
    """What is being opened, once it takes a while."""

    def __init__(self, parent: QWidget) -> None:
        self.progress = QProgressBar(minimum=0, maximum=0)
        self.progress.setFixedWidth(160)
        self.cancel = QPushButton("Cancel")
        self.cancel.setToolTip("What was open stays")
        super().__init__(parent, "busy", self.progress, self.cancel)
        self._due = QTimer(self, singleShot=True, interval=SHOWN_AFTER_MS)
        self._due.timeout.connect(self.show)

    def wait_for(self, what: str) -> None:
        """Say what is being opened, unless it is soon; nothing: it is over."""
        self.label.setText(f"Opening {what} …")
        if what and not self.isVisible():
            self._due.start()
        elif not what:
            self._due.stop()
            self.hide()


class HintBar(_Bar):
    """What a new user should know, once."""

    def __init__(self, parent: QWidget) -> None:
        self.understood = QPushButton("Got it")
        super().__init__(parent, "hint", self.understood)
        self.label.setText(HINT)
        self.understood.clicked.connect(self.hide)
