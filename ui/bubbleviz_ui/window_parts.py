"""Protocol of the window for menus and session files, to avoid a circular import."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from PySide6.QtGui import QUndoStack
    from PySide6.QtWidgets import QWidget

    from bubbleviz_ui.engine.controller import Controller
    from bubbleviz_ui.live.live_bar import LiveBar
    from bubbleviz_ui.live.live_controller import LiveController
    from bubbleviz_ui.model.messages import Messages
    from bubbleviz_ui.model.scene_presets import ScenePreset
    from bubbleviz_ui.model.session_state import SessionState
    from bubbleviz_ui.model.undo import SettingsHistory
    from bubbleviz_ui.panels.status_bar import StatusBar
    from bubbleviz_ui.pose.pose_panel import PosePanel
    from bubbleviz_ui.shell.message_bars import HintBar
    from bubbleviz_ui.shell.shortcuts import Shortcuts
    from bubbleviz_ui.view3d.render_view import View
    from bubbleviz_ui.view3d.scene import Scene
    from bubbleviz_ui.view3d.view_tools_panel import ViewTools


class WindowParts(Protocol):
    """Parts of the window by name, and what it does when it is asked to; see `MainWindow`."""

    state: SessionState
    controller: Controller
    live_controller: LiveController
    settings: SettingsHistory
    undo_stack: QUndoStack
    shortcuts: Shortcuts
    view: View
    scene: Scene
    panels: dict[str, QWidget]
    pose: PosePanel
    tools: ViewTools
    live: LiveBar
    status: StatusBar
    messages: Messages
    hint: HintBar

    def open_file(self, path: Path) -> None:
        """Open a sensor, an object's mesh, a session, a truth, or else a recording."""

    def use_scene(self, preset: ScenePreset) -> None:
        """Show the layers and panels of a scene."""

    def save_screenshot(self, path: Path) -> None:
        """Write the picture of the whole window."""

    def show_connect(self) -> None:
        """Choose a live source."""

    def show_information(self) -> None:
        """Show what the recording that is open has in it."""

    def show_pages(self) -> None:
        """Show the documentation."""

    def show_costs(self) -> None:
        """Show the time that each stage takes."""

    def show_export(self) -> None:
        """Export frames as files."""

    def show_import(self) -> None:
        """Make a recording of images or of another kind of recording."""

    def show_messages(self) -> None:
        """Show all messages of this session."""

    def show_palette(self) -> None:
        """Show the command palette."""

    def show_shortcuts(self) -> None:
        """Show the keys of every action."""
