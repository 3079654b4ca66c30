"""Message bar: what went wrong, inside the window, without stopping anything."""

from __future__ import annotations

from PySide6.QtWidgets import QApplication, QFrame, QHBoxLayout, QLabel, QPushButton, QWidget


class MessageBar(QFrame):
    """One message at a time; hidden while there is none."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("message")
        self._details = ""
        self.label = QLabel()
        self.label.setWordWrap(True)
        self.copy = QPushButton("Copy details")
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._details))
        self.dismiss = QPushButton("Dismiss")
        self.dismiss.clicked.connect(self.hide)
        row = QHBoxLayout(self)
        row.setContentsMargins(12, 6, 8, 6)
        row.addWidget(self.label, 1)
        row.addWidget(self.copy)
        row.addWidget(self.dismiss)
        self.hide()

    def say(self, message: str, details: str = "") -> None:
        """Show a message; details can be copied for a bug report."""
        self.label.setText(message)
        self._details = f"{message}\n{details}"
        self.copy.setVisible(bool(details))
        self.show()
