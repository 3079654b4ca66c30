"""Command palette: search of all menu actions, by keyboard."""

from __future__ import annotations

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QDialog, QLineEdit, QListWidget, QListWidgetItem, QVBoxLayout, QWidget

from bubbleviz_ui.shell.dock import fill
from bubbleviz_ui.shell.shortcuts import Shortcuts, ranked

WIDTH, HEIGHT = 520, 340
TOP = 60
"""Distance from the window's top edge, screen pixels."""
NO_MATCH = "No matching command"
LIST_KEYS = (Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_PageUp, Qt.Key.Key_PageDown)


class CommandPalette(QDialog):
    """Search box and list of actions; Enter runs the selected one, Escape closes."""

    def __init__(self, parent: QWidget, shortcuts: Shortcuts) -> None:
        super().__init__(parent, Qt.WindowType.Popup)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.resize(WIDTH, HEIGHT)
        self._shortcuts = shortcuts
        self.search = QLineEdit()
        self.search.setPlaceholderText("Type a command.  ↑ ↓ select, Enter runs it, Esc closes")
        self.list = QListWidget()
        self.list.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.list.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        fill(QVBoxLayout(self), self.search, self.list, margins=(8, 8, 8, 8))
        self.search.textChanged.connect(self._find)
        self.search.installEventFilter(self)
        self.list.itemClicked.connect(lambda _: self.run())
        self._find("")

    def open_over(self, window: QWidget) -> None:
        """Open in the upper half of a window, centred."""
        place = window.mapToGlobal(window.rect().topLeft())
        self.move(place.x() + (window.width() - WIDTH) // 2, place.y() + TOP)
        self.show()
        self.search.setFocus()

    def run(self) -> None:
        """Close the palette and run the selected action."""
        item = self.list.currentItem()
        if item is None or not item.flags():
            return
        action = self._shortcuts.actions[item.data(Qt.ItemDataRole.UserRole)]
        self.close()
        action.trigger()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Pass navigation keys to the list; the search box keeps the focus."""
        if event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent):
            if event.key() in LIST_KEYS:
                self.list.event(event)
                return True
            if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
                self.run()
                return True
        return super().eventFilter(watched, event)

    def _find(self, query: str) -> None:
        self.list.clear()
        actions = self._shortcuts.actions
        names = [name for name, action in actions.items() if action.isEnabled()]
        for name in ranked(query, names):
            keys = self._shortcuts.keys(name)
            item = QListWidgetItem(f"{name}    {keys}" if keys else name)
            item.setData(Qt.ItemDataRole.UserRole, name)
            self.list.addItem(item)
        if not self.list.count():
            nothing = QListWidgetItem(NO_MATCH)
            nothing.setFlags(Qt.ItemFlag.NoItemFlags)
            self.list.addItem(nothing)
        self.list.setCurrentRow(0)
