"""Search of menu actions, and keyboard shortcuts that the user can change."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from PySide6.QtCore import QObject, Signal
from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import (
    QAbstractItemView,
    QDialog,
    QHBoxLayout,
    QHeaderView,
    QKeySequenceEdit,
    QLabel,
    QLineEdit,
    QMenu,
    QMenuBar,
    QTableWidget,
    QTableWidgetItem,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from bubbleviz_ui.shell.dock import fill, push_button, resize_on_screen

STEP = " › "
"""Separator of menu names in the path of an action."""


def ranked(query: str, paths: list[str]) -> list[str]:
    """Paths that contain every typed word, best first, then by menu; without letters all paths.

    The letters of a typed word are those of a text, or beginnings of its words, as in "nextm".
    Whole words rank before them, an item's own name before its path, and its beginning first.
    """
    if not query.strip():
        return paths
    found = {path: _rank(query.lower(), path.lower()) for path in paths}
    return sorted((path for path in paths if found[path]), key=lambda path: found[path] or ())


def _rank(query: str, path: str) -> tuple[int, bool, int] | None:
    """Kind of match, whether the name does not begin with it, steps of the path; None: no match."""
    words, name = [_beginnings(word) for word in query.split()], path.split(STEP)[-1]
    if set(query.split()) <= set(re.findall(r"\w+", name)):
        kind = 0
    elif all(word.search(name) for word in words):
        kind = 1
    elif all(word.search(path) for word in words):
        kind = 2
    elif query in path:
        kind = 3
    else:
        return None
    return kind, not name.startswith(query), path.count(STEP)


def _beginnings(word: str) -> re.Pattern[str]:
    """Each letter follows the one before it, or begins a later word."""
    return re.compile(r"\b" + r"(?:|.*?\b)".join(map(re.escape, word)))


DYNAMIC = "unlisted"
"""Property of a menu with changing actions, such as recent files."""


class Shortcuts(QObject):
    """Keyboard shortcuts of a window's actions."""

    edited = Signal()  # Some shortcuts changed

    def __init__(self, bar: QMenuBar) -> None:
        super().__init__(bar)
        self.actions = dict(_named(bar, ""))  # By path: `View › Theme › Dark`
        self._defaults = {name: list(a.shortcuts()) for name, a in self.actions.items()}
        self.edited.connect(self._tell_keys)
        self._tell_keys()

    def give(self, buttons: Mapping[QToolButton, str], menu: str) -> None:
        """Give buttons the function, state and tool tip of the actions of a menu."""
        for button, name in buttons.items():
            button.setDefaultAction(self.actions[menu + STEP + name])

    def _tell_keys(self) -> None:
        for name, action in self.actions.items():
            what, keys = action.whatsThis() or name.split(STEP)[-1], self.keys(name)
            action.setToolTip(f"{what} ({keys})" if keys else what)

    @property
    def changed(self) -> dict[str, str]:
        """Changed keys by action; empty text: no keys."""
        return {
            name: QKeySequence.listToString(action.shortcuts())
            for name, action in self.actions.items()
            if list(action.shortcuts()) != self._defaults[name]
        }

    def keys(self, name: str) -> str:
        """Keys of an action in the platform's notation."""
        native = QKeySequence.SequenceFormat.NativeText
        return "  or  ".join(keys.toString(native) for keys in self.actions[name].shortcuts())

    def used_by(self, keys: QKeySequence, name: str) -> str | None:
        """Another action with these keys, or with keys of which one is the start of the other."""
        none = QKeySequence.SequenceMatch.NoMatch
        for other, action in self.actions.items():
            for theirs in action.shortcuts() if other != name else ():
                if theirs.matches(keys) != none or keys.matches(theirs) != none:
                    return other
        return None

    def set_keys(self, name: str, keys: QKeySequence) -> str:
        """Set the keys of an action; empty keys remove them.

        Returns str: Error message, or empty.
        """
        other = self.used_by(keys, name) if not keys.isEmpty() else None
        if other is not None:
            native = keys.toString(QKeySequence.SequenceFormat.NativeText)
            return f"{native} conflicts with the keys of “{other}”; choose others, or remove those."
        self.actions[name].setShortcuts([] if keys.isEmpty() else [keys])
        self.edited.emit()
        return ""

    def reset(self, name: str) -> str:
        """Restore the default keys of an action; returns an error message or empty."""
        for keys in self._defaults[name]:
            other = self.used_by(keys, name)
            if other is not None:
                native = keys.toString(QKeySequence.SequenceFormat.NativeText)
                return f"{native} conflicts with the keys of “{other}”; change those first."
        self.actions[name].setShortcuts(self._defaults[name])
        self.edited.emit()
        return ""

    def reset_all(self) -> None:
        """Restore the default keys of all actions."""
        for name, action in self.actions.items():
            action.setShortcuts(self._defaults[name])
        self.edited.emit()

    def use(self, changed: Mapping[str, str]) -> None:
        """Apply the changed keys of a session, and defaults for the rest; conflicts are skipped."""
        for name, action in self.actions.items():
            action.setShortcuts(self._defaults[name])
        for name in changed.keys() & self.actions.keys():
            self.actions[name].setShortcuts([])  # first clear all, so that keys can be swapped
        for name, text in changed.items():
            for keys in QKeySequence.listFromString(text) if name in self.actions else ():
                self.set_keys(name, keys)
        self.edited.emit()


def _named(menu: QMenuBar | QMenu, path: str) -> Iterator[tuple[str, QAction]]:
    for action in menu.actions():
        name = path + action.text().replace("&", "").rstrip("…")
        inner = action.menu()
        if isinstance(inner, QMenu):
            if not inner.property(DYNAMIC):
                yield from _named(inner, name + STEP)
        elif not action.isSeparator():
            yield name, action


# Dialog that lists and changes the keys of all actions.

SIZE = (560, 520)  # px


class ShortcutsDialog(QDialog):
    """Lists all actions and edits their keys; conflicting keys are rejected with a message."""

    def __init__(self, parent: QWidget, shortcuts: Shortcuts) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keyboard shortcuts")
        resize_on_screen(self, *SIZE)
        self._shortcuts = shortcuts
        self.search = QLineEdit(placeholderText="Find an action", clearButtonEnabled=True)
        self.table = QTableWidget(len(shortcuts.actions), 2)
        self.keys, self.problem = QKeySequenceEdit(), QLabel(wordWrap=True)
        self.keys.setToolTip("Press the new keys of the selected action here, then Set")
        self.set = push_button("&Set", "", lambda: self._set(self.keys.keySequence()))
        self.clear = push_button("&No keys", "", lambda: self._set(QKeySequence()))
        self.reset = push_button(
            "&Default", "", lambda: self.problem.setText(shortcuts.reset(self.name))
        )
        self.reset_all = push_button("&Reset all", "", shortcuts.reset_all)
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
        self._fill()
        self.search.textChanged.connect(self._filter)
        self.table.currentCellChanged.connect(lambda *_: self._show_keys())
        self.table.cellDoubleClicked.connect(lambda *_: self.keys.setFocus())
        self._shortcuts.edited.connect(self._fill)
        self.table.selectRow(0)

    @property
    def name(self) -> str:
        item = self.table.item(self.table.currentRow(), 0)
        return item.text() if item is not None else ""

    def _set(self, keys: QKeySequence) -> None:
        if self.name:
            self.problem.setText(self._shortcuts.set_keys(self.name, keys))

    def _fill(self) -> None:
        for row, name in enumerate(self._shortcuts.actions):
            for column, text in enumerate((name, self._shortcuts.keys(name))):
                self.table.setItem(row, column, QTableWidgetItem(text))
        self._show_keys()

    def _show_keys(self) -> None:
        self.problem.setText("")
        action = self._shortcuts.actions.get(self.name)
        if action is not None:
            self.keys.setKeySequence(action.shortcut())

    def _filter(self, text: str) -> None:
        for row, name in enumerate(self._shortcuts.actions):
            keys = self._shortcuts.keys(name)
            hidden = not ranked(text, [name]) and text.lower() not in keys.lower()
            self.table.setRowHidden(row, hidden)
        shown = [r for r in range(self.table.rowCount()) if not self.table.isRowHidden(r)]
        if shown:
            self.table.selectRow(shown[0])
