"""The name of a file: typed, or chosen in a dialog."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QHBoxLayout, QLineEdit, QPushButton, QWidget

from bubbleviz_ui.shell.file_dialogs import file_to_open
from bubbleviz_ui.shell.layouts import fill


class FileField(QWidget):
    """A line for the name of a file that is there, and a button that chooses it.

    Parameters
    ----------
    title, kinds : str
        Of the file dialog; filters as Qt writes them.
    placeholder : str
        What counts where the line is empty.

    Attributes
    ----------
    changed : Signal
        Another name was typed or chosen.
    """

    changed = Signal()

    def __init__(self, title: str, kinds: str, placeholder: str = "") -> None:
        super().__init__()
        self._title, self._kinds = title, kinds
        self.line = QLineEdit()
        self.line.setPlaceholderText(placeholder)
        self.browse = QPushButton("Browse…")
        self.browse.setAutoDefault(False)
        self.browse.setToolTip(title)
        fill(QHBoxLayout(self), (self.line, 1), self.browse, margins=(0, 0, 0, 0))
        self.setFocusProxy(self.line)
        self.line.textChanged.connect(lambda _: self.changed.emit())
        self.browse.clicked.connect(lambda: self._browse())

    @property
    def path(self) -> Path | None:
        """The file; None where no name is given."""
        name = self.line.text().strip()
        return Path(name) if name else None

    def _browse(self) -> None:
        path = file_to_open(self, self._title, self._kinds, of="import")
        if path is not None:
            self.line.setText(str(path))
