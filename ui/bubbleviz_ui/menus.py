"""Menus and their default shortcuts."""

from __future__ import annotations

import platform
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Qt, SignalInstance, qVersion
from PySide6.QtGui import QAction, QActionGroup, QKeySequence
from PySide6.QtWidgets import QDialog, QDockWidget, QInputDialog, QMenu, QMessageBox
from vtkmodules.vtkCommonCore import vtkVersion

import bubbleviz
from bubbleviz.files import pages_folder, preset_names
from bubbleviz.wording import count_of
from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.export.export_dialog import ExportDialog
from bubbleviz_ui.files import SESSIONS, TRUTHS, Files
from bubbleviz_ui.model.frame_history import CONTACT, UNTRUSTED
from bubbleviz_ui.model.registry import LAYERS
from bubbleviz_ui.model.scene_presets import load_scene
from bubbleviz_ui.model.settings import LOOPBACK, SPEEDS, Settings
from bubbleviz_ui.model.source_facts import SourceFacts, name_of
from bubbleviz_ui.model.units import UNIT_CHOICES
from bubbleviz_ui.panel_window import PanelWindow
from bubbleviz_ui.panels.status_bar import PerformancePopup
from bubbleviz_ui.panels.view_tools_panel import TOOLS, VIEWS
from bubbleviz_ui.playback.contacts_dialog import ContactsDialog
from bubbleviz_ui.session_saver import SessionSaver
from bubbleviz_ui.shell.binding import Binding, bind_exclusive, bind_membership
from bubbleviz_ui.shell.command_palette import CommandPalette
from bubbleviz_ui.shell.file_dialogs import SENSOR_FILES
from bubbleviz_ui.shell.settings_dialog import SettingsDialog
from bubbleviz_ui.shell.shortcuts import DYNAMIC, Shortcuts, ShortcutsDialog
from bubbleviz_ui.shell.text_dialogs import InformationDialog, MessagesDialog, PagesDialog

if TYPE_CHECKING:
    from bubbleviz_ui.importing.import_dialog import ImportDialog


class Menus(QObject):
    """Actions of the menu bar, their keys, and the dialogs that they open."""

    def __init__(self, window: PanelWindow, saver: SessionSaver, files: Files) -> None:
        super().__init__(window)
        self._window, self._saver, self._files, bar = window, saver, files, window.menuBar()
        self.importing = Worker("import")
        self._export: ExportDialog | None = None
        self._import: ImportDialog | None = None
        self._file(bar.addMenu("&File"))
        self._edit(bar.addMenu("&Edit"))
        self._playback(bar.addMenu("&Playback"))
        self._live(bar.addMenu("&Live"))
        self._view(bar.addMenu("&View"))
        self._help(bar.addMenu("&Help"))
        self.shortcuts = Shortcuts(bar)
        window.message.more.clicked.connect(self._messages.trigger)
        window.status.clicked.connect(self.show_performance)

    def close(self) -> None:
        """Stop an import."""
        self.importing.cancel()
        self.importing.close(0.0)

    # -- dialogs ------------------------------------------------------------------------------

    def show_performance(self) -> None:
        """Show the run time of each stage."""
        window = self._window
        popup = PerformancePopup(
            window, window.state, window.controller, window.stage_times, window.view
        )
        popup.open_over(window.status)

    def show_connect(self) -> None:
        """Open the dialog for live sources."""
        # imports every kind of source: not at start
        from bubbleviz_ui.live.connect_dialog import ConnectDialog

        window = self._window
        sensor = window.controller.sensor
        # that of a simulation says nothing about the camera to connect
        name = None if sensor is None or window.state.facts.simulated else name_of(sensor)
        _deleted_on_close(ConnectDialog(window, window.live_controller, name)).open()

    def show_export(self) -> None:
        if self._export is None:
            self._export = ExportDialog(self._window, self._window.state, self._window.exporting)
        self._export.show_all()
        self._export.show()
        self._export.raise_()

    def show_import(self) -> None:
        """Open the dialog that converts images or other recordings."""
        window = self._window
        if self._import is None:
            # imports readers of every kind of recording: not at start
            from bubbleviz_ui.importing.import_dialog import ImportDialog

            self._import = ImportDialog(
                window,
                self.importing,
                window.messages,
                window.controller.opening.open_recording,
                lambda: window.live_controller.recording.folder,
            )
        self._import.show()
        self._import.raise_()

    # -- menus --------------------------------------------------------------------------------

    def _file(self, menu: QMenu) -> None:
        files = self._files
        self._add(menu, "&Open recording…", files.choose_recordings, QKeySequence.StandardKey.Open)
        self._add(menu, "Open recording &folder…", files.choose_folder, "Ctrl+Shift+O")
        opening = self._window.controller.opening
        sensor = "Open sensor", SENSOR_FILES, "sensor", opening.open_sensor_file
        truth = "Open ground truth", TRUTHS, "recording", opening.use_ground_truth
        self._add(menu, "Open &sensor…", lambda: files.choose(*sensor), "Ctrl+E")
        self._add(menu, "Open ground &truth…", lambda: files.choose(*truth))
        self._recent(menu.addMenu("Open &recent"))
        self._depth_topics(menu.addMenu("Depth to&pic"))
        self._add(menu, "Re&load", opening.reload, "F5")
        about = self._window.controller, self._window.reading
        self._dialog(menu, "Infor&mation…", InformationDialog, *about, keys="Alt+Return")
        self._add(menu, "&Close", files.close, "Ctrl+W")
        menu.addSeparator()
        session = "Open session", SESSIONS, "session", self._saver.open
        self._add(menu, "Open sess&ion…", lambda: files.choose(*session))
        save = self._add(menu, "&Save session as…", files.save_session)
        save.setShortcuts([QKeySequence("Ctrl+S"), QKeySequence("Ctrl+Shift+S")])
        menu.addSeparator()
        self._add(menu, "I&mport…", self.show_import, "Ctrl+Shift+I")
        self._add(menu, "&Export…", self.show_export, "Ctrl+Shift+E")
        self._add(menu, "S&creenshot…", files.save_screenshot, "Ctrl+P")
        menu.addSeparator()
        self._add(menu, "&Quit", self._window.close, "Ctrl+Q")

    def _recent(self, menu: QMenu) -> None:
        menu.setProperty(DYNAMIC, True)

        def fill() -> None:
            menu.clear()
            for path in self._saver.recent:
                menu.addAction(path).triggered.connect(partial(self._files.open, Path(path)))
            menu.setEnabled(bool(self._saver.recent))

        self._saver.recent_changed.connect(fill)
        fill()

    def _depth_topics(self, menu: QMenu) -> None:
        """Topics of a recording of several depth cameras, to open it by another one."""
        menu.setProperty(DYNAMIC, True)
        opening = self._window.controller.opening

        def fill(facts: SourceFacts) -> None:
            menu.clear()
            for topic in facts.depth_topics:
                action = menu.addAction(topic)
                action.setCheckable(True)
                action.setChecked(topic == facts.depth_topic)
            menu.setEnabled(len(facts.depth_topics) > 1)

        def choose(action: QAction) -> None:
            source = opening.source
            if source is not None and source.path is not None:
                # without the ground truth, which is that of one sensor
                opening.open_recording(source.path, depth_topic=action.text())

        menu.triggered.connect(choose)
        self._window.state.source_changed.connect(fill)
        menu.setEnabled(False)

    def _help(self, menu: QMenu) -> None:
        window = self._window
        palette = self._add(
            menu,
            "&Command palette…",
            lambda: CommandPalette(window, self.shortcuts).open_over(window),
        )
        palette.setShortcuts([QKeySequence("Ctrl+K"), QKeySequence("Ctrl+Shift+P")])
        self._add(menu, "&Performance", self.show_performance, "Ctrl+I")
        self._messages = self._dialog(menu, "&Messages…", MessagesDialog, window.messages)
        self._dialog(menu, "&Documentation…", PagesDialog, pages_folder(), keys="F1")
        self._add(menu, "&First steps", window.hint.show)
        self._add(menu, "&Keyboard shortcuts…", self.show_shortcuts, "Ctrl+?")
        self._add(menu, "&About bubbleviz…", self._show_about)

    def show_shortcuts(self) -> None:
        _deleted_on_close(ShortcutsDialog(self._window, self.shortcuts)).open()

    def _show_about(self) -> None:
        about = QMessageBox(self._window)
        about.setWindowTitle("About bubbleviz")
        about.setText(
            f"bubbleviz {bubbleviz.__version__}\nCalibrate, view and debug Soft-bubble tactile "
            "sensors.\nMIT licence."
        )
        about.setInformativeText(
            f"Python {platform.python_version()}, Qt {qVersion()}, "
            f"VTK {vtkVersion.GetVTKVersion()}\n3-D quality: {self._window.view.quality.text}"
        )
        _deleted_on_close(about).open()

    def _edit(self, menu: QMenu) -> None:
        stack = self._window.undo_stack
        undo, redo = stack.createUndoAction(menu, "&Undo"), stack.createRedoAction(menu, "&Redo")
        undo.setShortcut("Ctrl+Z")
        redo.setShortcut("Ctrl+Shift+Z")
        menu.addActions([undo, redo])
        menu.addSeparator()
        settings = self._window.state, self._window.undo_recorder
        self._dialog(menu, "&Settings…", SettingsDialog, *settings, keys="Ctrl+,")

    def _playback(self, menu: QMenu) -> None:
        state = self._window.state
        self._add(menu, "&Play / pause", lambda: state.set_playing(not state.playing), "Space")
        self._add(menu, "Pre&vious frame", lambda: state.step(-1), "Left")
        self._add(menu, "&Next frame", lambda: state.step(1), "Right")
        for title, seconds, keys in (
            ("0.1 s back", -0.1, "Shift+Left"),
            ("0.1 s forward", 0.1, "Shift+Right"),
            ("1 s back", -1.0, "Ctrl+Left"),
            ("1 s forward", 1.0, "Ctrl+Right"),
        ):
            self._add(menu, title, partial(state.step_seconds, seconds), keys)
        self._add(menu, "&First frame", lambda: state.seek(0), "Home")
        self._add(menu, "&Last frame", lambda: state.seek(state.facts.frames - 1), "End")
        self._add(menu, "&Go to frame…", self._go_to_frame, "Ctrl+G")
        for title, kind, key in (
            ("{} contact", CONTACT, "Ctrl+Pg"),
            ("{} frame not trusted", UNTRUSTED, "Alt+Pg"),
        ):
            for which, direction, end in (("Next", 1, "Down"), ("Previous", -1, "Up")):
                seek = partial(self._seek_start, kind, direction)
                self._add(menu, title.format(which), seek, key + end)
        self._add(menu, "Largest force", self._seek_largest_force, "Ctrl+Home")
        self._dialog(menu, "&Contacts…", ContactsDialog, state)
        self._add(menu, "Analyse all frames", self._window.controller.analysis.start)
        menu.addSeparator()
        for title, direction, keys in (("Slower", -1, "Ctrl+Down"), ("Faster", 1, "Ctrl+Up")):
            self._add(menu, title, partial(self._change_speed, direction), keys)
        Binding(self._switch(menu, "&Every frame", "E"), state, "every_frame")
        Binding(self._switch(menu, "&Loop", "L"), state, "loop")
        self._add(menu, "Start range here", lambda: self._range_end(0), "[")
        self._add(menu, "End range here", lambda: self._range_end(1), "]")
        self._add(menu, "Play all frames", lambda: state.set_range(None), "Backspace")
        menu.addSeparator()
        CheckMark(
            self._switch(menu, "&Mark this frame", "M"),
            lambda: state.playhead in state.markers,
            lambda _: state.toggle_marker(state.playhead),
            state.markers_changed,
            state.frame_changed,
            state.history_changed,
            state.source_changed,
        )
        self._add(menu, "Next marker", lambda: state.seek_marker(1), "PgDown")
        self._add(menu, "Previous marker", lambda: state.seek_marker(-1), "PgUp")
        menu.addSeparator()
        CheckMark(
            self._switch(menu, "F&reeze a live source", "F"),
            lambda: state.frozen,
            state.freeze,
            state.frozen_changed,
            state.source_changed,
        )
        self._add(menu, "Go &live", lambda: state.freeze(False), "N")

    def _live(self, menu: QMenu) -> None:
        window, live = self._window, self._window.live_controller
        self._add(menu, "&Connect…", self.show_connect, "Ctrl+L")
        tip = "Disconnect, or stop connecting"
        self._add(menu, "&Disconnect", live.leave, "Ctrl+Shift+L", tip)
        menu.addSeparator()
        CheckMark(
            self._switch(menu, "&Record", "Ctrl+R", "Record the live source to a new file"),
            lambda: live.recording.busy,
            lambda _: live.toggle_recording(),
            live.recording.changed,
        )
        self._add(menu, "Recording &folder…", window.live.choose_folder)
        self._add(menu, "Add a &note…", window.live.start_note, "Shift+M")
        tip = (
            "Start or stop publishing patch, force, pose and diagnostics over Zenoh (address: Live "
            "→ Publish at)"
        )
        CheckMark(
            self._switch(menu, "&Publish results", "Ctrl+Shift+R", tip),
            lambda: live.publishing.on,
            lambda _: live.toggle_publishing(),
            live.publishing.changed,
        )
        self._add(menu, "Publish &at…", self._publish_at)
        tip = "Zero the gas pressure in the next contact-free frames"
        self._add(menu, "&Zero gas pressure", live.zero_now, "Ctrl+Shift+G", tip)
        self._add(menu, "&Switch sensor", window.group.choose_next, "B")

    def _view(self, menu: QMenu) -> None:
        window = self._window
        self._add(menu, "&Reset view", window.scene.reset_view, "R")
        look = menu.addMenu("&View from")
        for number, (viewpoint, title) in enumerate(VIEWS.items(), start=1):
            go, side = (
                partial(window.scene.look_from, viewpoint),
                f"{viewpoint}, in the bubble frame B",
            )
            tip = f"View from the {'depth camera' if viewpoint == 'camera' else side}"
            self._add(look, title, go, f"Ctrl+{number}", tip)
        tip = "Rotate about the vertical automatically, 30° per second"
        self._switch(menu, "T&urntable", "T", tip).toggled.connect(
            window.tools.turntable.set_turning
        )
        for name, (_, title, keys, tip) in TOOLS.items():
            tool = self._switch(menu, title, keys, tip)
            tool.triggered.connect(
                lambda on, name=name: window.tools.use_tool(name if on else "rotate")
            )
        self._add(menu, "Reset p&ose", window.pose.session.reset, "Ctrl+Shift+F")
        layers = menu.addMenu("&Visible layers")
        for name, kind in LAYERS.items():
            bind_membership(self._switch(layers, kind.title), window.state, "layers", name)
        scenes = menu.addMenu("&Scene")
        for name in preset_names("scenes"):
            preset = load_scene(name)
            self._add(scenes, preset.title, partial(window.use_scene, preset))
        full = Qt.WindowState.WindowFullScreen
        CheckMark(
            self._switch(menu, "&Full screen", "F11"),
            window.isFullScreen,
            lambda _: window.setWindowState(window.windowState() ^ full),
            menu.aboutToShow,
        )
        self._one_of(menu.addMenu("&Theme"), "theme")
        self._one_of(menu.addMenu("&Units"), *UNIT_CHOICES)
        menu.addSeparator()
        for panel in window.panels.values():
            if isinstance(panel, QDockWidget):
                menu.addAction(panel.toggleViewAction())
        bind_membership(self._switch(menu, "Status bar"), window.state, "panels", "status")

    def _one_of(self, menu: QMenu, *fields: str) -> None:
        """Add exclusive actions for the values of each setting."""
        for field in fields:
            group = QActionGroup(menu)
            for value, title in (Settings.info(field).titles or {}).items():
                action = group.addAction(menu.addAction(title))
                action.setCheckable(True)
                bind_exclusive(action, self._window.state, field, value)
            menu.addSeparator()

    def _add(
        self,
        menu: QMenu,
        title: str,
        do: Callable[[], object],
        keys: str | QKeySequence.StandardKey | None = None,
        tip: str = "",  # Of buttons that do the same
    ) -> QAction:
        action = QAction(title, menu, whatsThis=tip)
        if keys is not None:
            action.setShortcut(QKeySequence(keys))
        action.triggered.connect(lambda: do())
        menu.addAction(action)
        return action

    def _dialog(
        self,
        menu: QMenu,
        title: str,
        make: Callable[..., QDialog],
        *arguments: object,  # After the parent
        keys: str | None = None,
    ) -> QAction:
        """Add an action that shows a new dialog."""
        return self._add(
            menu, title, lambda: _deleted_on_close(make(self._window, *arguments)).show(), keys
        )

    def _switch(self, menu: QMenu, title: str, keys: str = "", tip: str = "") -> QAction:
        """Add a checkable action."""
        action = QAction(title, menu, checkable=True, whatsThis=tip)
        action.setShortcut(QKeySequence(keys))
        menu.addAction(action)
        return action

    def _change_speed(self, direction: int) -> None:
        state = self._window.state
        place = SPEEDS.index(state.settings.speed) + direction
        state.change(speed=SPEEDS[min(max(place, 0), len(SPEEDS) - 1)])

    def _range_end(self, end: int) -> None:
        state = self._window.state
        first, last = state.play_range or (0, state.facts.frames - 1)
        here = state.playhead
        state.set_range((first, here) if end else (here, last))

    def _go_to_frame(self) -> None:
        state = self._window.state
        last = state.facts.frames - 1
        frame, chosen = QInputDialog.getInt(
            self._window, "Go to frame", f"Frame, 0 to {last}", state.frame, 0, last
        )
        if chosen:
            state.step(frame - state.frame)

    def _seek_start(self, kind: int, direction: int) -> None:
        state = self._window.state
        found = state.history.next_start(kind, state.frame, direction)
        what = "contact" if kind == CONTACT else "frame that is not trusted"
        self._seek_found(found, f"No further {what}")

    def _seek_largest_force(self) -> None:
        self._seek_found(self._window.state.history.largest_force(), "No contact", "Largest force")

    def _seek_found(self, frame: int | None, nothing: str, found: str = "") -> None:
        """Go to a frame found in the computed ones; say what it is if there are others."""
        state, missing = self._window.state, self._window.state.left_to_analyse
        rest = f" so far; {count_of(missing, 'frame')} left to analyse" if missing else ""
        if frame is not None:
            state.step(frame - state.frame)
        if frame is None or (found and missing):
            self._window.messages.add("notice", (nothing if frame is None else found) + rest)

    def _publish_at(self) -> None:
        state = self._window.state
        endpoint, chosen = QInputDialog.getText(
            self._window,
            "Publish results",
            "Publish at tcp/HOST:PORT, from the next start of publishing.\n"
            "HOST 127.0.0.1: only this computer can receive results;\n"
            "a network address of this computer: others can, too",
            text=state.settings.publish_at,
        )
        if chosen:
            state.change(publish_at=endpoint.strip() or LOOPBACK)


def _deleted_on_close(dialog: QDialog) -> QDialog:
    """A dialog that is deleted when it is closed; else the window would keep every one opened."""
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    return dialog


class CheckMark(QObject):
    """Keeps an action's check mark equal to `is_on`, even if switching fails.

    Owned by the action, as a lambda connected to a signal would keep the window alive.

    `*changed`: Signals after which the state may differ.
    """

    def __init__(
        self,
        action: QAction,  # Checkable
        is_on: Callable[[], bool],
        turn: Callable[[bool], object],  # Switches it on or off
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
