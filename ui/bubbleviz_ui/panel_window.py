"""Window with the 3-D view and all panels, connected to the model and arranged in any size."""

from __future__ import annotations

import math
import time
from dataclasses import fields
from functools import partial
from pathlib import Path

from PySide6.QtCore import QByteArray, QEvent, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent, QResizeEvent, QUndoStack
from PySide6.QtWidgets import QApplication, QLayout, QMainWindow, QSizePolicy, QVBoxLayout, QWidget

from bubbleviz.files import preset_names
from bubbleviz.result import Result
from bubbleviz_ui.calibration.calibration_panel import CalibrationPanel
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.hover import Hover
from bubbleviz_ui.engine.solver import Opened
from bubbleviz_ui.engine.upkeep import MemoryRelease
from bubbleviz_ui.engine.worker import Failed, Worker, wait_until_ended
from bubbleviz_ui.export.exporting import Exporting
from bubbleviz_ui.live.live_bar import DisplayLatency, LiveBar
from bubbleviz_ui.live.live_controller import LiveController
from bubbleviz_ui.live.sensor_group import SensorGroup
from bubbleviz_ui.model.demand import StageTimes
from bubbleviz_ui.model.messages import CALIBRATION, OPENING, SOURCE, UserMessage
from bubbleviz_ui.model.registry import PANELS
from bubbleviz_ui.model.scene_presets import ScenePreset
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.settings import PATCH_SETTINGS, PLAYBACK_SETTINGS, Settings
from bubbleviz_ui.model.source_facts import SourceFacts, name_of, title_text
from bubbleviz_ui.model.undo import UndoRecorder
from bubbleviz_ui.model.units import UNIT_CHOICES
from bubbleviz_ui.panels.compare_panel import ComparePanel
from bubbleviz_ui.panels.images_panel import ImagesPanel
from bubbleviz_ui.panels.kappa_panel import KappaPanel, ThresholdPanel
from bubbleviz_ui.panels.layers_panel import LayersPanel
from bubbleviz_ui.panels.plot_host import import_plots
from bubbleviz_ui.panels.plots_panel import PlotsPanel
from bubbleviz_ui.panels.status_bar import StatusBar
from bubbleviz_ui.panels.view_tools_panel import ViewTools
from bubbleviz_ui.playback.playback_panel import PlaybackPanel
from bubbleviz_ui.pose.pose_overlay import PoseOverlay
from bubbleviz_ui.pose.pose_panel import PosePanel
from bubbleviz_ui.pose.pose_session import PoseSession
from bubbleviz_ui.sensor.sensor_panel import SensorPanel
from bubbleviz_ui.shear.shear_panel import ShearPanel
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import watch_controls
from bubbleviz_ui.shell.dock import (
    FRAME,
    Dock,
    TabsForRoom,
    column,
    fill,
    in_front,
    resize_on_screen,
    scrolled,
)
from bubbleviz_ui.shell.file_dialogs import last_sensor, remember, remember_sensor, write_picture
from bubbleviz_ui.shell.message_bars import BusyBar, HintBar, MessageBar, NoticeBar
from bubbleviz_ui.view3d.pointing import Pointing
from bubbleviz_ui.view3d.render_view import FAST, RenderQuality, View
from bubbleviz_ui.view3d.scene import Scene

SIZE = (1280, 800)  # px, of a new window
NARROW = 1000
"""Below this width, px, the timeline is placed below the panels."""
IMAGES_BESIDE_VIEW = 1200
"""Below this width, px, the images panel is a tab of the plots panel."""
RATES_EVERY_MS = 500
PLOTS_AFTER_S = 2.0
"""Time after the first source is open when the plotting library is imported, in a thread."""
UNDO_STEPS = 200
"""Limited because some steps hold collected frames."""
DRAWN = frozenset(each.name for each in fields(Settings)) - (
    PATCH_SETTINGS | PLAYBACK_SETTINGS | {"theme", "panels", "plots", "images"}
)
"""Settings whose change redraws the 3-D view; it follows the theme by its palette."""
SIDE_WIDTH = 310
"""Of the panels at the right in a new window, for numbers with their intervals, px."""
SIDES = {
    "right": Qt.DockWidgetArea.RightDockWidgetArea,
    "bottom": Qt.DockWidgetArea.BottomDockWidgetArea,
    "left": Qt.DockWidgetArea.LeftDockWidgetArea,
}


class PanelWindow(QMainWindow):
    """The 3-D view, the bars above it, and the panels in docks.

    `quality`: Render quality of the 3-D view.
    """

    def __init__(
        self, state: SessionState, controller: Controller, quality: RenderQuality = FAST
    ) -> None:
        super().__init__()
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("bubbleviz")
        self.setAcceptDrops(True)
        resize_on_screen(self, *SIZE)
        # Else X11 counts in steps of 2 px from the minimum size at 150 %, and the window shrinks
        # by a pixel whenever `_fit` changes that
        self.setBaseSize(1, 1)
        self.state = state
        self.controller = controller  # Closed with the window
        self.messages = state.messages
        self.message = MessageBar(self)
        self.notice = NoticeBar(self.menuBar())
        self.busy = BusyBar(self)
        self.hint = HintBar(self)
        self.view = View(self, quality)
        state.cloud_decimation = quality.cloud_decimation
        self.scene = Scene(self.view, state)
        self.status = StatusBar(state.units)
        self.layers = LayersPanel(state)
        self.kappa = KappaPanel(state)
        self.playback = PlaybackPanel(state)
        self.threshold = ThresholdPanel(state, controller)
        self.compare = ComparePanel(state, controller)
        self.plots = PlotsPanel(state, controller)
        self.hover = Hover(controller)
        self.images = ImagesPanel(state, controller, self.hover, self.scene.scales)
        self.tools = ViewTools(state, controller, self.view, self.scene)
        self.pointing = Pointing(state, self.view, self.scene, self.hover)
        self.undo_stack = QUndoStack(self)
        self.undo_stack.setUndoLimit(UNDO_STEPS)
        self.undo_recorder = UndoRecorder(state, self.undo_stack)
        self.sensor = SensorPanel(state, controller)
        self.stage_times = StageTimes()
        self.calibration = CalibrationPanel(
            Calibration(controller, self.undo_recorder), state.units
        )
        self.pose = PosePanel(state, PoseSession(controller, self.undo_recorder))
        self.overlay = PoseOverlay(self.view, self.scene, self.pose.session, state)
        self.shear = ShearPanel(state, controller)
        self.group = SensorGroup(controller, self.scene, self.view)
        self.live_controller = LiveController(controller, self.group, self.view, self.undo_recorder)
        self.live = LiveBar(self.live_controller, controller, self.group, state.units)
        self.display_latency = DisplayLatency(controller, self.view)
        self.exporting = Exporting(controller, self.view, lambda: self.pose.session.rows)
        self._source: object = None
        self.reading = Worker("reading")
        self._memory = MemoryRelease(state)
        self._docks: dict[str, Dock] = {}
        self._side_width = SIDE_WIDTH
        layout = self.layout()
        assert layout is not None
        layout.setSizeConstraint(QLayout.SizeConstraint.SetNoConstraint)  # see `_fit`
        self._lay_out()
        self._rates_timer = QTimer(self, interval=RATES_EVERY_MS)
        self._connect()

    def use_scene(self, preset: ScenePreset) -> None:
        """Apply a scene preset: layers, panels, viewpoint."""
        with self.undo_recorder.one_step("scene"):
            self.show_only(preset.settings["panels"])
            self.state.change(**preset.settings)
        self.scene.reset_view()

    @property
    def open_panels(self) -> frozenset[str]:
        """Names of the open panels, whether or not their tab is in front."""
        docks = frozenset(name for name, dock in self._docks.items() if not dock.isHidden())
        return docks | (self.state.settings.panels & {"status"})

    def show_only(self, names: frozenset[str]) -> None:
        """Open these panels and close all others."""
        closed_first = sorted(self._docks, key=lambda name: name in names)  # they make room
        for name in closed_first:
            self._docks[name].setVisible(name in names)
        self.state.include("panels", "status", "status" in names)

    def save_screenshot(self, path: Path) -> None:
        self.messages.report("picture", path, partial(write_picture, path, self.grab()))

    def _use_theme(self, scheme: Qt.ColorScheme) -> None:
        application = QApplication.instance()
        if isinstance(application, QApplication):
            theme.apply(application, theme.chosen(self.state.settings.theme, scheme))

    def closeEvent(self, event: QCloseEvent) -> None:
        """Stop timers and threads, then release VTK."""
        self._rates_timer.stop()
        self.state.blockSignals(True)  # receivers are being deleted
        self.calibration.calibration.close()
        self.exporting.close()
        for worker in (self.reading, self.compare.other.worker):
            worker.cancel()
            worker.close(0.0)
        self._memory.close()
        self.undo_stack.clear()  # steps keep references to what they change
        self.live_controller.close()
        self.controller.close()
        if wait_until_ended():  # else they are removed when the process ends
            self.calibration.remove_files()
        self.view.close()
        super().closeEvent(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Arrange docks for the new size."""
        super().resizeEvent(event)
        self._share_width()
        for dock in self._docks.values():
            dock.restore_height()
        self._part_tabs()

    def event(self, event: QEvent) -> bool:
        """Fit docks whose contents changed; keep heights that were dragged.

        While a redraw of the view is due, nothing else is painted: both show the same frame.
        """
        if event.type() == QEvent.Type.UpdateRequest and self.view.redraw_due:
            return True
        done = super().event(event)
        if event.type() == QEvent.Type.LayoutRequest and self.isVisible():
            self._fit()
        elif event.type() == QEvent.Type.MouseButtonRelease and event.isAccepted():
            # of a line between docks: other clicks are left to the window's parent
            self._fit_width(dragged=True)
            for dock in self._docks.values():
                dock.keep_height()
        return done

    def _fit(self) -> None:
        """Turn docks into tabs if the window would otherwise grow, perhaps beyond the screen."""
        for dock in self._docks.values():
            if dock.too_low:
                self._make_tabs(dock)
        self._fit_width()
        for side in SIDES.values():
            shown = column(self, side)
            if self.minimumSizeHint().height() > self.height() and shown:
                self._make_tabs(max(shown, key=lambda dock: dock.opened_s))
        self._part_tabs()
        tabs = self.tabifiedDockWidgets(self._docks["playback"])
        policy = QSizePolicy.Policy.Preferred
        fixed = all(dock.isHidden() for dock in tabs)  # else the others would be as low
        self.playback.setSizePolicy(policy, QSizePolicy.Policy.Fixed if fixed else policy)
        room = self.screen().availableSize() - FRAME
        self.setMinimumSize(self.minimumSizeHint().boundedTo(room))

    def _make_tabs(self, front: Dock) -> None:
        """Make tabs at the side of a dock; also hide the first-run hint."""
        self.tabs.make(front)
        self.hint.hide()
        self._centre.updateGeometry()

    def _part_tabs(self) -> None:
        """Undo the tabs of `_fit` if there is room."""
        for name, side in SIDES.items():
            spare = self.view.height() - self.view.minimumHeight() if name == "bottom" else 0
            self.tabs.part(side, spare)

    @property
    def dragged(self) -> dict[str, int]:
        """Sizes that the operator chose, which the present window may not have room for."""
        heights = {name: dock.above_hint for name, dock in self._docks.items() if dock.above_hint}
        return {"right": self._side_width, **heights}

    def restore_layout(self, layout: QByteArray, dragged: dict[str, int]) -> None:
        """Restore the layout of a session by `saveState`, with its dragged sizes."""
        self._side_width = dragged.get("right", SIDE_WIDTH)
        for name, dock in self._docks.items():
            dock.above_hint = dragged.get(name, 0)
            dock.restoring = True
        self.restoreState(layout)
        for dock in self._docks.values():
            dock.restoring = False
            dock.restore_height()

    def _fit_width(self, *, dragged: bool = False) -> None:
        """Keep the width of the panels at the right, or take it back after one that needed more.

        `dragged`: Whether the operator may have changed it.
        """
        shown = column(self, SIDES["right"])
        if not shown or (QApplication.mouseButtons() and not dragged):  # while it is dragged
            return
        front, least = in_front(shown), max(dock.minimumSizeHint().width() for dock in shown)
        kept = max(least, self._side_width)
        if dragged and front.width() != kept:
            self._side_width = front.width()
        elif front.width() > kept:
            self.resizeDocks([front], [kept], Qt.Orientation.Horizontal)

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:
        self.view.dragEnterEvent(event)

    def dropEvent(self, event: QDropEvent) -> None:
        self.view.dropEvent(event)

    def _lay_out(self) -> None:
        self._centre = QWidget()
        fill(
            QVBoxLayout(self._centre),
            self.message,
            self.busy,
            self.hint,
            self.live,
            (self.view, 1),
            margins=(0, 0, 0, 0),
            spacing=0,
        )
        self.setCentralWidget(self._centre)
        self.setStatusBar(self.status)
        watch_controls(self.live)
        self.panels = self._make_docks()

    def _make_docks(self) -> dict[str, QWidget]:
        """Create the docks of all panels except the status bar."""
        # its numbers stay in view; why they are not trusted, below them, may be scrolled
        kappa = scrolled(self.kappa)
        kappa.setMinimumHeight(self.kappa.minimumSizeHint().height())
        shown: dict[str, QWidget] = {
            "layers": scrolled(self.layers),
            "kappa": kappa,
            "threshold": scrolled(self.threshold),
            "compare": scrolled(self.compare),
            "tools": scrolled(self.tools),
            "sensor": scrolled(self.sensor),
            "pose": scrolled(self.pose),
            "shear": scrolled(self.shear),
            "calibration": self.calibration,
            "plots": self.plots,
            "images": self.images,
            "playback": self.playback,
        }
        docks: dict[str, Dock] = {}
        for name, widget in shown.items():
            kind, sized = PANELS[name], name in ("plots", "images")
            narrower_than = IMAGES_BESIDE_VIEW if name == "images" else math.inf
            home = docks.get(kind.tab_of)
            docks[name] = dock = Dock(kind.title, self, home, narrower_than, sized=sized)
            dock.setObjectName(kind.title)
            dock.setWidget(widget)
            watch_controls(widget)
            self.addDockWidget(SIDES[kind.side or "right"], dock)
            if not kind.by_default:
                dock.hide()
            dock.visibilityChanged.connect(partial(self.state.include, "panels", name))
        self.splitDockWidget(docks["plots"], docks["playback"], Qt.Orientation.Vertical)
        self._share_width()
        self._docks, self.tabs = docks, TabsForRoom(self, list(docks.values()))
        self._fit_width()
        return {**docks, "status": self.status}

    def _share_width(self) -> None:
        """Place the timeline below the panels if the window is too narrow for both."""
        below = "bottom" if self.width() < NARROW else "right"
        self.setCorner(Qt.Corner.BottomRightCorner, SIDES[below])

    def _connect(self) -> None:
        self.controller.replaced.connect(self._on_replaced)
        self.controller.opened.connect(self._on_opened)
        self.controller.shown.connect(self._on_shown)
        self.controller.failed.connect(self._on_failed)
        self.pose.session.changed.connect(self._on_pose)
        self.messages.added.connect(self._show_message)
        self.messages.revised.connect(self.message.revise)
        self.controller.opening.changed.connect(self.busy.wait_for)
        self.busy.cancel.clicked.connect(self.controller.opening.cancel)
        self.compare.measured.connect(self.scene.compare)
        self.compare.other.aligned.connect(self.plots.show_other)
        self.compare.other.membrane.connect(self.group.compare)
        self.undo_recorder.watch("open panels", None, lambda: self.open_panels, self.show_only)
        for text, box in self.calibration.boxes.items():
            self.undo_recorder.watch_box(text, box)
        self.playback.timeline.range_dragged.connect(self._play_range)
        self._rates_timer.timeout.connect(self.show_rates)
        self._rates_timer.start()
        self.view.follow_theme(lambda _: self.scene.redraw())
        QApplication.styleHints().colorSchemeChanged.connect(self._use_theme)
        self.state.source_changed.connect(self._on_source)
        self.state.frozen_changed.connect(self._show_title)
        self.state.connection_changed.connect(self._on_connection)
        self.state.follow({"panels"}, self._show_status)
        self.state.follow({"theme"}, lambda: self._use_theme(theme.system_scheme()))
        self.state.follow(UNIT_CHOICES, self._show_units)
        self.state.follow(DRAWN, self.scene.redraw)
        self.state.history_changed.connect(self.scene.follow_scales)

    def _play_range(self, frames: tuple[int, int]) -> None:
        """Loop over a range dragged on the timeline."""
        with self.undo_recorder.one_step("range"):
            self.state.set_range(frames)
            self.state.change(loop=True)

    def _show_message(self, message: UserMessage) -> None:
        quiet = message.kind == "notice"
        if quiet and message.topic:
            self.message.drop_topic(message.topic)
        (self.notice if quiet else self.message).show_message(message)

    def _on_replaced(self) -> None:
        """Remove warnings about the previous source; the other sensors keep theirs."""
        kept = [each.prefix for each in self.controller.others]
        self.message.keep(lambda message: message.kind == "error" or message.topic in kept)

    def _on_source(self, facts: SourceFacts) -> None:
        self._show_title()
        self.status.show_source(facts, self._sensor_title(facts))

    def _on_connection(self) -> None:
        self._show_title()
        outdated = self.state.badge in ("stale", "reconnecting")
        self.scene.set_outdated(outdated)
        for label in (*self.status.numbers, *self.kappa.numbers):
            label.setDisabled(outdated)

    def _show_title(self) -> None:
        facts, badge = self.state.facts, self.state.badge
        status = f" ({badge})" if badge else ""
        parts = f"{facts.title}{status}", self._sensor_title(facts), "bubbleviz"
        self.setWindowTitle(" – ".join(filter(None, parts)))

    def _sensor_title(self, facts: SourceFacts) -> str:
        sensor = self.controller.sensor
        return facts.sensor_name if sensor is None else title_text(sensor)

    def _show_status(self) -> None:
        self.status.setVisible("status" in self.state.settings.panels)

    def _show_units(self) -> None:
        """Update all numbers after a change of units."""
        self.status.fit_units()
        self._write_numbers()
        self.show_rates()
        self.calibration.calibration.changed.emit()

    def _on_opened(self, opened: Opened) -> None:
        if self._source is None:
            self.reading.submit(import_plots, due_s=time.perf_counter() + PLOTS_AFTER_S)
        path = opened.request.source.path
        if path is not None:
            remember("recording", path)
        name, camera = name_of(opened.sensor), opened.sensor.camera
        size = camera.width, camera.height
        if opened.request.source is not self._source:  # reopening the same keeps the focus
            self._source = opened.request.source
            self.view.setFocus()
            for topic in (SOURCE, CALIBRATION):
                self.message.drop_topic(topic)
            own = last_sensor(size)
            if path is not None and name in preset_names("sensors") and own is not None:
                self.messages.add("notice", f"A preset is in use instead of {own.name}", file=own)
        self.message.drop_topic(OPENING)
        if name is not None and name.endswith(".toml"):
            remember_sensor(Path(name), size)
        self.scene.depth_camera = opened.camera
        self.stage_times.clear()
        self.scene.set_sensor(opened.sensor, opened.mesh)

    def _on_shown(self, result: Result) -> None:
        self.stage_times.take(result)
        start = time.perf_counter()
        self.scene.show(result)
        self.view.busy_s += time.perf_counter() - start
        self._write_numbers()

    def _write_numbers(self) -> None:
        """Show the numbers of the current result in the panels."""
        result, state, sensor = self.controller.result, self.state, self.group.chosen_name
        self.playback.show_frame()
        self.kappa.show_result(result)
        self.status.show_result(
            result, state.facts, state.history, final=state.final, sensor=sensor
        )

    def _on_pose(self) -> None:
        if not self.pose.session.problem:
            self.message.drop_topic("object")

    def _on_failed(self, failed: Failed) -> None:
        message, topic = failed.message, "object" if failed.key == "object" else SOURCE
        if failed.key == "open":
            stays = "" if self.state.facts.is_empty else " The current source stays open."
            message, topic = f"{message.rstrip('.')}.{stays}", OPENING
        elif not self.state.facts.grows:
            self.state.set_playing(False)
        self.messages.add("error", message, failed.details, topic=topic)

    def show_rates(self) -> None:
        """Show frame rates and latency in the status bar."""
        now = time.perf_counter()
        controller, view = self.controller, self.view
        self.status.show_rates(
            controller.client.solve_rate.rate_hz(now),
            view.render_rate.rate_hz(now),
            controller.dropped,
        )
        self.status.show_latency(self.display_latency.report())
