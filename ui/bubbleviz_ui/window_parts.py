"""Protocol of the window for menus and session files, which avoids a circular import."""

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
    from bubbleviz_ui.model.undo import UndoRecorder
    from bubbleviz_ui.panels.status_bar import StatusBar
    from bubbleviz_ui.pose.pose_panel import PosePanel
    from bubbleviz_ui.shell.message_bars import HintBar
    from bubbleviz_ui.shell.shortcuts import Shortcuts
    from bubbleviz_ui.view3d.render_view import View
    from bubbleviz_ui.view3d.scene import Scene
    from bubbleviz_ui.view3d.view_tools_panel import ViewTools


class WindowParts(Protocol):
    """Parts and actions of `MainWindow` used by menus and session files."""

    state: SessionState
    controller: Controller
    live_controller: LiveController
    undo_recorder: UndoRecorder
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
        """Open a sensor, object mesh, session, ground truth or recording."""

    def open_recordings(self, paths: list[Path]) -> None:
        """Open a recording, or two as two sensors."""

    def use_scene(self, preset: ScenePreset) -> None:
        """Apply a scene preset."""

    def save_screenshot(self, path: Path) -> None:
        """Write a screenshot of the window."""

    def show_connect(self) -> None:
        """Open the dialog for live sources."""

    def show_information(self) -> None:
        """Show the contents of the open recording."""

    def show_pages(self) -> None:
        """Show the documentation."""

    def show_performance(self) -> None:
        """Show the run time of each stage."""

    def show_export(self) -> None:
        """Open the export dialog."""

    def show_import(self) -> None:
        """Open the dialog that converts images or other recordings."""

    def show_messages(self) -> None:
        """Show all messages of this session."""

    def show_palette(self) -> None:
        """Show the command palette."""

    def show_shortcuts(self) -> None:
        """Show the keyboard shortcuts."""
