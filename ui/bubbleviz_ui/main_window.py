"""Main window: the panels with menus, keys, files and the session."""

from __future__ import annotations

from PySide6.QtGui import QCloseEvent

from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.files import Files
from bubbleviz_ui.menus import Menus
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.panel_window import PanelWindow
from bubbleviz_ui.session_saver import SessionSaver
from bubbleviz_ui.view3d.render_view import FAST, RenderQuality


class MainWindow(PanelWindow):
    """The main window.

    `quality`: Render quality of the 3-D view.
    """

    def __init__(
        self, state: SessionState, controller: Controller, quality: RenderQuality = FAST
    ) -> None:
        super().__init__(state, controller, quality)
        self._confirms_close = True
        self.session_saver = SessionSaver(self, lambda: self.shortcuts.changed)
        self.files = Files(self, self.session_saver)
        self.menus = Menus(self, self.session_saver, self.files)
        self.shortcuts = keys = self.menus.shortcuts
        for panel in (self.playback, self.tools, self.live):
            panel.use_actions(keys)
        self.undo_recorder.watch("keys", keys.edited, lambda: keys.changed, keys.use)

    def close_without_asking(self) -> None:
        """Close without asking about unsaved work."""
        self._confirms_close = False
        self.close()

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask about unsaved work, save the session and stop everything."""
        if self._confirms_close and not self.calibration.confirm_close():
            event.ignore()
            return
        self.session_saver.close()
        self.menus.close()
        super().closeEvent(event)
