"""Which live session is connected, and what the user does with it."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import QObject, QTimer, Signal

from bubbleviz.live import LiveSensor, SessionPreset
from bubbleviz.recordings import gas_warning
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import Source
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.live.connection import Connection, LiveRun
from bubbleviz_ui.live.publishing import PRODUCTS, Publishing
from bubbleviz_ui.live.recording_control import OWN_FOLDER, Recording
from bubbleviz_ui.live.sensor_pair import SensorPair
from bubbleviz_ui.model.messages import OPENING, UserMessage
from bubbleviz_ui.model.settings import RECORDING_SETTINGS
from bubbleviz_ui.model.source_facts import ConnectionState, untrusted_text
from bubbleviz_ui.model.undo import UndoRecorder
from bubbleviz_ui.view3d.render_view import View

LOOK_MS = 200
"""How often sources are looked at: a stale one is seen as such within a second."""


class LiveController(QObject):
    """Connects, follows what is connected, and lets go of it."""

    looked = Signal()  # Time to show how the sources and the recording are doing
    changed = Signal()  # Another session is connected, or none; another sensor is chosen
    notified = Signal(object)  # A sentence for the user, and details of a bug

    def __init__(
        self, controller: Controller, pair: SensorPair, view: View, undo: UndoRecorder
    ) -> None:
        super().__init__()
        self._controller, self._pair, self.state = controller, pair, controller.state
        self._undo = undo
        self._worker = Worker("live")
        self.recording, self.publishing = Recording(self._worker), Publishing()
        self.connection: Connection | None = None  # While a session is being brought up
        self.run: LiveRun | None = None  # What is connected
        self._marked: frozenset[int] = frozenset()
        self._warnings: frozenset[str] = frozenset()
        self._drawn = False
        self._timer = QTimer(self, interval=LOOK_MS)
        self._timer.timeout.connect(self._on_tick)
        self._due = True
        for part in (self.recording, self.publishing):
            part.notified.connect(self.notified)
            part.changed.connect(self.looked)
        self.publishing.changed.connect(self._ask_what_goes_out)
        controller.opened.connect(self._on_opened)
        controller.shown.connect(self._on_shown)
        controller.failed.connect(self._on_failed)
        view.rendered.connect(self._on_rendered)
        pair.failed.connect(self._on_second_failed)
        self.state.settings_changed.connect(self._on_settings)
        self.state.markers_changed.connect(self._on_markers)

    @property
    def chosen(self) -> int:
        """Number of the sensor that the panels show."""
        return self._pair.chosen

    @property
    def sensor(self) -> LiveSensor | None:
        """The sensor that the panels show."""
        return None if self.run is None else self.run.session.sensors[self.chosen]

    @property
    def connection_state(self) -> ConnectionState:
        """How that sensor is doing: `connecting` until its first frame is on the screen."""
        if self.sensor is None:
            return "disconnected"
        return self.sensor.stream.status().state if self._drawn else "connecting"

    def doubt_about(self, number: int) -> str:
        """Why what is shown of a sensor is not to be trusted; empty where it is."""
        result = self._pair.result_of(number)
        return "" if result is None else untrusted_text(result)

    def choose_folder(self, folder: str | Path) -> None:
        """Put the next recordings there."""
        self.state.change(record_folder=str(folder))

    def connect_to(self, preset: SessionPreset) -> None:
        """Bring a session up; what is open stays until it sends frames."""
        self.cancel()
        self.connection = connection = Connection(preset, self.state.settings.pre_roll_s)
        connection.ready.connect(self._on_ready)
        connection.failed.connect(self._on_not_connected)
        connection.start()
        self._timer.start()
        self.changed.emit()

    def cancel(self) -> None:
        """Give up connecting."""
        connection, self.connection = self.connection, None
        if connection is not None:
            connection.cancel()
            self.changed.emit()

    def disconnect_all(self) -> None:
        """Let go of the sources; the frames that are kept can still be looked at."""
        self.cancel()
        self.recording.stop()
        self.publishing.stop()
        self._pair.end()
        run, self.run, self._drawn = self.run, None, False
        self.state.set_connection("disconnected")
        if run is not None:
            self._worker.submit(run.close)  # after the recording, which has the same thread
            self.changed.emit()
        self._timer.stop()

    def toggle_recording(self) -> None:
        """Begin or end a recording."""
        if self.recording.busy:
            self.recording.stop()
        elif self.run is not None:
            self.recording.start(self.run.session.recorder)

    def toggle_publishing(self) -> None:
        """Publish results, or stop that."""
        if self.publishing.on:
            self.publishing.stop()
        elif self.run is not None:
            self.publishing.start(self.run)

    def choose(self, number: int) -> None:
        """Have the panels show a sensor of two."""
        self._pair.choose(number)
        self.changed.emit()

    def choose_other(self) -> None:
        """Have the panels show the other sensor."""
        self.choose(1 - self.chosen)

    def zero_now(self) -> None:
        """Take the gas pressure's zero from the next contact-free frames; undo brings it back."""
        if self.sensor is None:
            return
        zero = self.sensor.zero
        rest_pa, waiting = zero.rest_pa, zero.waiting

        def ask(anew: bool) -> None:
            zero.zero_now() if anew else zero.restore(rest_pa, waiting=waiting)

        self._undo.push("gas pressure zero", ask, False, True)

    def close(self) -> None:
        """End everything; a recording is whole when this returns.

        On a disk that keeps it waiting for longer than a closing window waits, it is so when the
        process ends.
        """
        connection = self.connection
        self.disconnect_all()
        self._pair.close()
        self.publishing.close()
        self._worker.close()
        if connection is not None:
            connection.wait(5.0)

    # -- inside -------------------------------------------------------------------------------

    def _on_second_failed(self, failed: Failed) -> None:
        self.notified.emit(UserMessage("error", failed.message, failed.details))

    def _on_tick(self) -> None:
        """Look, if no picture came meanwhile: texts that change beside one cost another upload."""
        if self._due:
            self._look()
        self._due = True
        self._pair.look()

    def _on_shown(self, _: object) -> None:
        if self._due and self._timer.isActive():
            self._look()

    def _on_rendered(self) -> None:
        """Notice that the first frame of what is connected has been drawn."""
        present = self._controller.opening.current
        if not self._drawn and present is not None and self._is_ours(present.request):
            self._drawn = True
            self._look()

    def _look(self) -> None:
        self._due = False
        self.state.set_connection(self.connection_state)
        self._warn()
        self.publishing.diagnose()
        self.looked.emit()

    def _warn(self) -> None:
        """Say once of each sensor whose zero is more than weather that its file is wrong."""
        sensors = () if self.run is None else self.run.session.sensors
        found: set[str] = set()
        for live in sensors:
            text = gas_warning(live.zero.rest_pa, live.zero.reference_pa, "without contact")
            if text:
                found.add(f"{live.place.name}: {text}." if len(sensors) > 1 else f"{text}.")
        for text in sorted(found - self._warnings):
            self.notified.emit(UserMessage("warning", text))
        self._warnings = frozenset(found)

    def _on_ready(self, run: LiveRun) -> None:
        frames, sensor = run.frames[0], run.session.sensors[0].sensor
        opening = self._controller.opening
        if not opening.open(Source.of_stream(frames), lambda: sensor):
            self.cancel()
            self._worker.submit(run.close)
            return
        self.disconnect_all()
        self.run = run
        self._pair.prepare(run)
        self._use_settings()
        self._timer.start()
        self.changed.emit()

    def _on_not_connected(self, failed: Failed) -> None:
        self.connection = None
        if self.run is None:
            self._timer.stop()
        self.notified.emit(UserMessage("error", failed.message, failed.details, topic=OPENING))
        self.changed.emit()

    def _is_ours(self, request: OpenRequest) -> bool:
        return self.run is not None and request.source.stream in self.run.frames

    def _on_opened(self, opened: Opened) -> None:
        self._marked = frozenset()
        self._warnings = frozenset()  # the window has dropped its own
        if self.run is not None and self._is_ours(opened.request):
            self._pair.begin()
        elif self.run is not None:
            self.disconnect_all()

    def _on_failed(self, failed: Failed) -> None:
        request = failed.request
        if isinstance(request, OpenRequest) and self._is_ours(request):
            facts = self.state.facts
            if facts is None or self.run is None or facts.title != self.run.frames[0].name:
                self.disconnect_all()

    def _use_settings(self) -> None:
        """Record and publish as the user chose."""
        settings = self.state.settings
        self.recording.folder = Path(settings.record_folder or OWN_FOLDER)
        self.publishing.endpoint = settings.publish_at
        if self.run is not None:
            self.run.session.recorder.pre_roll_s = settings.pre_roll_s

    def _on_settings(self, names: frozenset[str]) -> None:
        if names & RECORDING_SETTINGS:
            self._use_settings()

    def _on_markers(self) -> None:
        marked = frozenset(self.state.markers)
        for frame in sorted(marked - self._marked):
            self._mark(frame)
        self._marked = marked

    def _mark(self, frame: int) -> None:
        """A marker on the timeline is one in the file, at the moment the frame arrived."""
        facts = self.state.facts
        if facts is not None and facts.grows and self.run is not None:
            at_ns = self.run.frames[self.chosen].arrival_ns(frame)
            self.recording.mark(f"marker at frame {frame}", at_ns)

    def _ask_what_goes_out(self) -> None:
        self._pair.ask_besides(PRODUCTS if self.publishing.on else frozenset())
