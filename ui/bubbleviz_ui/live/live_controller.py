"""Controller of the live session: connection, recording, publishing."""

from __future__ import annotations

import time
from pathlib import Path

from PySide6.QtCore import QObject, QTimer, Signal

from bubbleviz.live import STALE_AFTER_S, LiveSensor, SessionPreset, is_simulated
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import PlacedSensor, Source
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.live.connection import Connection, LiveRun
from bubbleviz_ui.live.publishing import PRODUCTS, Publishing
from bubbleviz_ui.live.recording_control import DEFAULT_FOLDER, Recording
from bubbleviz_ui.live.sensor_group import SensorGroup
from bubbleviz_ui.model.messages import OPENING
from bubbleviz_ui.model.settings import RECORDING_SETTINGS
from bubbleviz_ui.model.source_facts import ConnectionState
from bubbleviz_ui.model.undo import UndoRecorder
from bubbleviz_ui.view3d.render_view import View

UPDATE_MS = 200
"""Period of status updates."""
CAMERA_HUNG = "the depth camera repeats one image, to the last bit; restart the camera"


class LiveController(QObject):
    """Connects to a live session, monitors and disconnects it."""

    updated = Signal()  # Status of sources and recording may have changed
    changed = Signal()  # Session connected or disconnected

    def __init__(
        self, controller: Controller, group: SensorGroup, view: View, undo: UndoRecorder
    ) -> None:
        super().__init__()
        self._controller, self._group, self.state = controller, group, controller.state
        self._undo = undo
        self._worker = Worker("live")
        self.recording = Recording(self._worker, self.state.messages)
        self.publishing = Publishing(self.state.messages)
        self.connection: Connection | None = None  # While connecting
        self.run: LiveRun | None = None  # While connected
        self._marked: frozenset[int] = frozenset()
        self._warnings: frozenset[str] = frozenset()
        self._first_drawn = False
        self._timer = QTimer(self, interval=UPDATE_MS)
        self._timer.timeout.connect(self._on_tick)
        self._update_due = True
        for part in (self.recording, self.publishing):
            part.changed.connect(self.updated)
        self.publishing.changed.connect(self._update_published_products)
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        controller.failed.connect(self._on_failed)
        view.rendered.connect(self._on_rendered)
        self.state.follow(RECORDING_SETTINGS, self._apply_settings)
        self.state.markers_changed.connect(self._on_markers)

    @property
    def sensor(self) -> LiveSensor | None:
        """The sensor shown by the panels."""
        return None if self.run is None else self.run.session.sensors[self._controller.chosen]

    @property
    def connection_state(self) -> ConnectionState:
        """State of that sensor: `connecting` until its first frame has been drawn.

        A frame shown so long that its source would be stale is stale, whatever has arrived since.
        """
        if self.sensor is None:
            return "disconnected"
        state = self.sensor.stream.status().state if self._first_drawn else "connecting"
        return "stale" if state == "live" and self.shown_age_s > STALE_AFTER_S else state

    @property
    def shown_age_s(self) -> float:
        """Time since the arrival of the frame shown, s; 0 while frozen."""
        if not self.state.advancing:
            return 0.0
        return 1e-9 * (time.time_ns() - self._controller.result.frame.arrival_ns)

    def connect_to(self, preset: SessionPreset) -> None:
        """Connect to a session; the current source stays open until frames arrive."""
        self.cancel()
        self.connection = connection = Connection(preset, self.state.settings.pre_roll_s)
        connection.ready.connect(self._on_ready)
        connection.failed.connect(self._on_not_connected)
        connection.start()
        self._timer.start()
        self.changed.emit()

    def cancel(self) -> None:
        """Stop connecting."""
        connection, self.connection = self.connection, None
        if connection is not None:
            connection.cancel()
            self.changed.emit()

    def leave(self) -> None:
        """Stop connecting to another source, else disconnect."""
        if self.connection is not None and self.run is not None:
            self.cancel()
        else:
            self.disconnect_all()

    def disconnect_all(self) -> None:
        """Disconnect from the sources; the frames kept in memory stay visible."""
        self.cancel()
        self.recording.stop()
        self.publishing.stop()
        self._controller.regroup()
        run, self.run, self._first_drawn = self.run, None, False
        self.state.set_connection("disconnected")
        if run is not None:
            self._worker.submit(run.close)  # after the recording, in the same thread
            self.changed.emit()
        self._timer.stop()

    def toggle_recording(self) -> None:
        if self.recording.busy:
            self.recording.stop()
        elif self.run is not None:
            self.recording.start(self.run.session.recorder)

    def toggle_publishing(self) -> None:
        if self.publishing.on:
            self.publishing.stop()
        elif self.run is not None:
            self.publishing.start(self.run)

    def zero_now(self) -> None:
        """Zero the gas pressure in the next contact-free frames; undo restores the old zero."""
        if self.sensor is None:
            return
        zero = self.sensor.zero
        rest_pa, waiting = zero.rest_pa, zero.waiting

        def apply(new: bool) -> None:
            zero.zero_now() if new else zero.restore(rest_pa, waiting=waiting)

        self._undo.push("gas pressure zero", apply, False, True)

    def close(self) -> None:
        """Stop everything; a recording is complete when the threads have ended."""
        self.disconnect_all()
        self.publishing.close()
        self._worker.close(0.0)

    # -- inside -------------------------------------------------------------------------------

    def _on_tick(self) -> None:
        """Update the status, unless it was updated with a picture, which saves a redraw."""
        if self._update_due:
            self._update()
        self._update_due = True
        self._group.follow_if_alone()

    def _on_shown(self, _: object) -> None:
        if self._update_due and self._timer.isActive():
            self._update()

    def _on_rendered(self) -> None:
        """Detect that the first frame of the session has been drawn."""
        present = self._controller.opening.current
        if (
            not self._first_drawn
            and present is not None
            and self._is_connected_source(present.request)
        ):
            self._first_drawn = True
            self._update()

    def _update(self) -> None:
        self._update_due = False
        self.state.set_connection(self.connection_state)
        self._warn()
        self.publishing.diagnose()
        self.updated.emit()

    def _warn(self) -> None:
        """Warn once per sensor of images that never change."""
        if self.run is None or not self._first_drawn:  # opening clears the message bar
            return
        sensors = self.run.session.sensors
        found: set[str] = set()
        for live in sensors:
            if live.stream.frozen and not is_simulated(live.place.source):
                before = f"{live.place.name}: " if len(sensors) > 1 else ""
                found.add(f"{before}{CAMERA_HUNG}.")
        for text in sorted(found - self._warnings):
            self.state.messages.add("warning", text)
        self._warnings = frozenset(found)

    def _on_ready(self, run: LiveRun) -> None:
        sensors = [
            PlacedSensor(
                each.place.name,
                each.place.colour,
                Source.of_stream(frames),
                lambda sensor=each.sensor: sensor,  # type: ignore[misc]
                each.place.T_W_B,
            )
            for each, frames in zip(run.session.sensors, run.frames, strict=True)
        ]
        if not self._controller.opening.open_group(sensors):
            self.cancel()
            self._worker.submit(run.close)
            return
        self.disconnect_all()
        self.run = run
        self._apply_settings()
        self._timer.start()
        self.changed.emit()

    def _on_not_connected(self, failed: Failed) -> None:
        self.connection = None
        if self.run is None:
            self._timer.stop()
        self.state.messages.add("error", failed.message, failed.details, topic=OPENING)
        self.changed.emit()

    def _is_connected_source(self, request: OpenRequest) -> bool:
        return self.run is not None and request.source.stream in self.run.frames

    def _on_opened(self, opened: Opened) -> None:
        self._marked = frozenset()
        self._warnings = frozenset()  # the message bar was cleared as well
        if self.run is not None and not self._is_connected_source(opened.request):
            self.disconnect_all()

    def _on_failed(self, failed: Failed) -> None:
        request, run = failed.request, self.run
        shown = run is not None and self.state.facts.title == run.frames[0].name
        if isinstance(request, OpenRequest) and self._is_connected_source(request) and not shown:
            self.disconnect_all()

    def _apply_settings(self) -> None:
        settings = self.state.settings
        self.recording.folder = Path(settings.record_folder or DEFAULT_FOLDER)
        self.publishing.endpoint = settings.publish_at
        if self.run is not None:
            self.run.session.recorder.pre_roll_s = settings.pre_roll_s

    def _on_markers(self) -> None:
        """Write new markers of the timeline to the recording, at the frames' arrival times."""
        marked = frozenset(self.state.markers)
        for frame in sorted(marked - self._marked):
            if self.state.facts.grows and self.run is not None:
                at_ns = self.run.frames[self._controller.chosen].arrival_ns(frame)
                self.recording.mark(f"marker at frame {frame}", at_ns)
        self._marked = marked

    def _update_published_products(self) -> None:
        self._controller.set_extra_products(PRODUCTS if self.publishing.on else frozenset())
