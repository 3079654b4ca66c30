"""The dialog with all messages of this session."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QHBoxLayout,
    QPlainTextEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz_ui.model.messages import Messages, UserMessage
from bubbleviz_ui.shell.layouts import fill

SIZE = (640, 360)  # px: fits a screen of 1024×700


class MessagesDialog(QDialog):
    """Time, kind and text of each message, the newest last; new ones come while it is open."""

    def __init__(self, parent: QWidget, messages: Messages) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("Messages of this session")
        self.resize(*SIZE)
        self._messages = messages
        self.text = QPlainTextEdit(readOnly=True)
        self.text.setPlaceholderText("No messages yet")
        self.copy = QPushButton("&Copy all")
        self.copy.setToolTip("All messages, with the details of those that have some")
        self.copy.clicked.connect(self._copy)
        fill(QVBoxLayout(self), self.text, fill(QHBoxLayout(), 1, self.copy))
        for message in messages.all:
            self._add(message)
        messages.told.connect(self._add)

    def _add(self, message: UserMessage) -> None:
        self.text.appendPlainText(message.line())

    def _copy(self) -> None:
        reports = [message.report() for message in self._messages.all]
        QApplication.clipboard().setText("\n".join(reports))
