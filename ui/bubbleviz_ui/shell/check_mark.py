"""A check mark in a menu that follows what it turns on and off."""

from __future__ import annotations

from collections.abc import Callable

from PySide6.QtCore import QObject, SignalInstance
from PySide6.QtGui import QAction


class CheckMark(QObject):
    """Keeps an action's mark what `is_on` says, also where turning it on or off is refused.

    It lives as long as the action; a lambda that a signal holds would keep the window alive.

    Parameters
    ----------
    action : QAction
        Checkable.
    is_on : callable
        Whether what the action stands for is on.
    turn : callable
        Turns it on or off.
    *changed : signals
        It may have been turned on or off.
    """

    def __init__(
        self,
        action: QAction,
        is_on: Callable[[], bool],
        turn: Callable[[bool], object],
        *changed: SignalInstance,
    ) -> None:
        super().__init__(action)
        self._action, self._is_on, self._turn = action, is_on, turn
        action.triggered.connect(self._on_triggered)
        for signal in changed:
            signal.connect(self._show)
        self._show()

    def _on_triggered(self, on: bool) -> None:
        self._turn(on)
        self._show()

    def _show(self) -> None:
        self._action.setChecked(self._is_on())
