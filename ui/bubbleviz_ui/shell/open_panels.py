"""Which panels are open: what a person opens and closes, not which tab is in front."""

from __future__ import annotations

from collections.abc import Mapping

from PySide6.QtCore import QEvent, QObject, Signal
from PySide6.QtWidgets import QWidget

from bubbleviz_ui.model.session_state import SessionState

STATUS = "status"


class OpenPanels(QObject):
    """Panels of the window by their names in scene presets.

    Attributes
    ----------
    changed : Signal
        A panel was opened or closed.
    """

    changed = Signal()
    _status_changed = Signal()

    def __init__(self, panels: Mapping[str, QWidget], state: SessionState, parent: QObject) -> None:
        super().__init__(parent)
        self._status_changed.connect(self._note_status)
        self._panels, self._state = panels, state
        for panel in panels.values():
            panel.installEventFilter(self)

    @property
    def names(self) -> frozenset[str]:
        """Those that are open."""
        return frozenset(name for name, panel in self._panels.items() if not panel.isHidden())

    def show_only(self, names: frozenset[str]) -> None:
        """Open these and close the others."""
        for name, panel in self._panels.items():
            panel.setVisible(name in names)

    def close(self) -> None:
        """Watch no more: the window takes its panels down one by one."""
        for panel in self._panels.values():
            panel.removeEventFilter(self)

    def _note_status(self) -> None:
        """Docks ask for what they show while they are in front; the status bar always is."""
        self._state.choose_panel(STATUS, STATUS in self.names)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Notice that somebody has opened or closed one; hiding the window closes none."""
        if event.type() in (QEvent.Type.ShowToParent, QEvent.Type.HideToParent):
            if watched is self._panels[STATUS]:
                self._status_changed.emit()
            self.changed.emit()
        return False
