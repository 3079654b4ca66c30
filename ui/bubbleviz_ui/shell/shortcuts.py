"""Everything the menus offer, by name, and the keys for it: the user's where they were changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from PySide6.QtCore import QObject, Signal
from PySide6.QtGui import QAction, QKeySequence
from PySide6.QtWidgets import QMenu, QMenuBar

from bubbleviz_ui.shell.fuzzy_search import STEP

UNLISTED = "unlisted"
"""Property of a menu whose actions come and go, such as recent files."""


class Shortcuts(QObject):
    """Keys of a window's actions.

    Attributes
    ----------
    actions : dict
        Actions of the menus by name: `View › Theme › Dark`.
    edited : Signal
        Some action has other keys.
    """

    edited = Signal()

    def __init__(self, bar: QMenuBar) -> None:
        super().__init__(bar)
        self.actions = dict(_named(bar, ""))
        self._defaults = {name: list(a.shortcuts()) for name, a in self.actions.items()}

    @property
    def changed(self) -> dict[str, str]:
        """Keys by action where they are not the default ones; empty for none."""
        return {
            name: QKeySequence.listToString(action.shortcuts())
            for name, action in self.actions.items()
            if list(action.shortcuts()) != self._defaults[name]
        }

    def keys(self, name: str) -> str:
        """Keys of an action as the platform writes them."""
        native = QKeySequence.SequenceFormat.NativeText
        return "  or  ".join(keys.toString(native) for keys in self.actions[name].shortcuts())

    def taken_by(self, keys: QKeySequence, name: str) -> str | None:
        """Other action that has these keys, or begins with them, or that they begin with."""
        none = QKeySequence.SequenceMatch.NoMatch
        for other, action in self.actions.items():
            for theirs in action.shortcuts() if other != name else ():
                if theirs.matches(keys) != none or keys.matches(theirs) != none:
                    return other
        return None

    def set_keys(self, name: str, keys: QKeySequence) -> str:
        """Give an action other keys; empty keys take them away.

        Returns
        -------
        str
            Why not, in one sentence; empty when it is done.
        """
        other = self.taken_by(keys, name) if not keys.isEmpty() else None
        if other is not None:
            native = keys.toString(QKeySequence.SequenceFormat.NativeText)
            return f"{native} is taken by “{other}”; choose other keys or take them away there."
        self.actions[name].setShortcuts([] if keys.isEmpty() else [keys])
        self.edited.emit()
        return ""

    def reset(self, name: str) -> str:
        """Give an action its default keys again; says why not, as `set_keys`."""
        for keys in self._defaults[name]:
            other = self.taken_by(keys, name)
            if other is not None:
                native = keys.toString(QKeySequence.SequenceFormat.NativeText)
                return f"{native} is taken by “{other}” now; reset that first."
        self.actions[name].setShortcuts(self._defaults[name])
        self.edited.emit()
        return ""

    def reset_all(self) -> None:
        """Give every action its default keys again."""
        for name, action in self.actions.items():
            action.setShortcuts(self._defaults[name])
        self.edited.emit()

    def use(self, changed: Mapping[str, str]) -> None:
        """Take keys from a session, the default ones for the rest; what is taken stays as it is."""
        for name, action in self.actions.items():
            action.setShortcuts(self._defaults[name])
        for name in changed.keys() & self.actions.keys():
            self.actions[name].setShortcuts([])  # first room for all, then each in its place
        for name, text in changed.items():
            for keys in QKeySequence.listFromString(text) if name in self.actions else ():
                self.set_keys(name, keys)
        self.edited.emit()


def _named(menu: QMenuBar | QMenu, path: str) -> Iterator[tuple[str, QAction]]:
    for action in menu.actions():
        name = path + action.text().replace("&", "").rstrip("…")
        inner = action.menu()
        if isinstance(inner, QMenu):
            if not inner.property(UNLISTED):
                yield from _named(inner, name + STEP)
        elif not action.isSeparator():
            yield name, action
