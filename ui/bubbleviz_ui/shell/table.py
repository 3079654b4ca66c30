"""Table of texts to read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from PySide6.QtCore import Qt
from PySide6.QtGui import QPalette
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableWidget, QTableWidgetItem

RIGHT = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
ROW = 20
"""Height of a row, screen pixels."""


class Table(QTableWidget):
    """A table that takes neither focus nor selection.

    `titles`: Of the columns.
    `stretched`: Column that takes the remaining width; the others are as wide as their texts.
    """

    def __init__(self, titles: Sequence[str] = (), stretched: int = 0) -> None:
        super().__init__(0, len(titles))
        self.setHorizontalHeaderLabels(titles)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.verticalHeader().setMinimumSectionSize(ROW)
        self.verticalHeader().setDefaultSectionSize(ROW)
        self.verticalHeader().setVisible(not titles)
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        if titles:
            self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
            stretch = QHeaderView.ResizeMode.Stretch
            self.horizontalHeader().setSectionResizeMode(stretched, stretch)

    def write(self, row: int, texts: Iterable[str], *, right: range, dim: bool = False) -> None:
        """Write a row; `right`: columns of numbers; `dim`: in the colour of what does not count."""
        for column, text in enumerate(texts):
            item = QTableWidgetItem(text)
            item.setToolTip(text)
            if dim:
                item.setForeground(self.palette().color(QPalette.ColorRole.PlaceholderText))
            if column in right:
                item.setTextAlignment(RIGHT)
            self.setItem(row, column, item)

    @property
    def full_height(self) -> int:
        """Height at which all rows are shown, screen pixels."""
        head = self.horizontalHeader().sizeHint().height()
        return head + self.verticalHeader().length() + 2 * self.frameWidth()
