"""The dialog that lists the keys of every action and changes them."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import (
    QAbstractItemView,
    QDialog,
    QHBoxLayout,
    QHeaderView,
    QKeySequenceEdit,
    QLabel,
    QLineEdit,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from bubbleviz_ui.shell.fuzzy_search import score
from bubbleviz_ui.shell.layouts import fill
from bubbleviz_ui.shell.shortcuts import Shortcuts

SIZE = (560, 520)  # px: fits a screen of 1024×700


class ShortcutsDialog(QDialog):
    """Find an action, press new keys for it. Keys that are taken are refused with a sentence."""

    def __init__(self, parent: QWidget, shortcuts: Shortcuts) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("Keyboard shortcuts")
        self.resize(*SIZE)
        self._shortcuts = shortcuts
        self.search = QLineEdit()
        self.search.setPlaceholderText("Find an action")
        self.search.setClearButtonEnabled(True)
        self.table = QTableWidget(len(shortcuts.actions), 2)
        self.keys = QKeySequenceEdit()
        self.keys.setToolTip("Press the new keys here")
        self.set = QPushButton("&Set")
        self.clear = QPushButton("&No keys")
        self.reset = QPushButton("&Default")
        self.reset_all = QPushButton("Default for &all")
        self.problem = QLabel(wordWrap=True)
        self.problem.setObjectName("problem")
        self._lay_out()
        self._fill()
        self._connect()
        self.table.selectRow(0)

    @property
    def name(self) -> str:
        """The action that is chosen."""
        item = self.table.item(self.table.currentRow(), 0)
        return item.text() if item is not None else ""

    def _lay_out(self) -> None:
        table = self.table
        table.setHorizontalHeaderLabels(["Action", "Keys"])
        table.verticalHeader().hide()
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        table.setTabKeyNavigation(False)
        table.horizontalHeader().setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        table.horizontalHeader().setSectionResizeMode(1, QHeaderView.ResizeMode.ResizeToContents)
        row = QHBoxLayout()
        row.addWidget(self.keys, 1)
        for button in (self.set, self.clear, self.reset, self.reset_all):
            button.setAutoDefault(False)
            row.addWidget(button)
        fill(QVBoxLayout(self), self.search, table, self.problem, row)

    def _connect(self) -> None:
        self.search.textChanged.connect(self._filter)
        self.table.currentCellChanged.connect(lambda *_: self._show_keys())
        self.table.cellDoubleClicked.connect(lambda *_: self.keys.setFocus())
        self.set.clicked.connect(lambda: self._set(self.keys.keySequence()))
        self.clear.clicked.connect(lambda: self._set(QKeySequence()))
        self.reset.clicked.connect(lambda: self._say(self._shortcuts.reset(self.name)))
        self.reset_all.clicked.connect(self._shortcuts.reset_all)
        self._shortcuts.edited.connect(self._fill)

    def _set(self, keys: QKeySequence) -> None:
        if self.name:
            self._say(self._shortcuts.set_keys(self.name, keys))

    def _say(self, problem: str) -> None:
        self.problem.setText(problem)

    def _fill(self) -> None:
        for row, name in enumerate(self._shortcuts.actions):
            for column, text in enumerate((name, self._shortcuts.keys(name))):
                self.table.setItem(row, column, QTableWidgetItem(text))
        self._show_keys()

    def _show_keys(self) -> None:
        self._say("")
        action = self._shortcuts.actions.get(self.name)
        if action is not None:
            self.keys.setKeySequence(action.shortcut())

    def _filter(self, text: str) -> None:
        for row, name in enumerate(self._shortcuts.actions):
            keys = self._shortcuts.keys(name)
            hidden = score(text, name) is None and text.lower() not in keys.lower()
            self.table.setRowHidden(row, hidden)
        shown = [r for r in range(self.table.rowCount()) if not self.table.isRowHidden(r)]
        if shown:
            self.table.selectRow(shown[0])
