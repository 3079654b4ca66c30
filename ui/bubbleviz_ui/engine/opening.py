"""Opening: another source, another sensor, or the present ones in another form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from bubbleviz.sensor import load_sensor
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import NO_SOURCE, Source, sensor_for
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.messages import UserMessage
from bubbleviz_ui.model.session_state import SessionState

if TYPE_CHECKING:
    from bubbleviz.inverse import EstimatorOptions
    from bubbleviz.sensor import Sensor

    OpenSensor = Callable[[], Sensor]


class Opening(QObject):
    """Asks the solver thread to open things; what is open stays until that works.

    `ask`: Takes a request to the solver thread.
    """

    # What is being opened or closed, in words; empty when it is, or is not going to be
    changed = Signal(str)
    notified = Signal(object)  # A `UserMessage`
    # An `OpenRequest` before it is asked; whoever needs what is open may have it `cancelled`
    wanted = Signal(object)

    def __init__(self, state: SessionState, ask: Callable[[OpenRequest], None]) -> None:
        super().__init__()
        self._state, self._ask = state, ask
        self.present: Opened | None = None  # What is open
        self._waiting: OpenRequest | None = None

    @property
    def sensor(self) -> Sensor | None:
        """The sensor in use; None before the first."""
        return None if self.present is None else self.present.sensor

    @property
    def source(self) -> Source | None:
        """What is open; None before the first."""
        return None if self.present is None else self.present.request.source

    @property
    def options(self) -> EstimatorOptions | None:
        """Of what is open, or is being opened; None before the first."""
        if self._waiting is not None:
            return self._waiting.options
        return None if self.present is None else self.present.request.options

    def open(
        self,
        source: Source,
        open_sensor: OpenSensor,
        *,
        what: str = "",  # What to call it in a message; the source's title where not given
        frame: int = 0,
        playing: bool = True,
        first: Callable[[], None] | None = None,
    ) -> bool:
        """Open a source with a sensor in the solver thread; whether that was not refused.

        What is done `first`, unless it was, may make other settings.
        """
        request = OpenRequest(
            source=source,
            open_sensor=open_sensor,
            frame=frame,
            demand=Demand.of(self._state.settings),
            playing=playing,
        )
        self.wanted.emit(request)
        if request.cancelled.is_set():
            return False
        if first is not None:
            first()
        self.cancel()
        settings = self._state.settings
        demand, options = Demand.of(settings), settings.options
        request = replace(request, demand=demand, options=options)
        self._waiting = request
        self._ask(request)
        self.changed.emit(
            "Closing …" if source is NO_SOURCE else f"Opening {what or source.title} …"
        )
        return True

    def cancel(self) -> None:
        """Open nothing; the solver stops at its next step."""
        if self._waiting is not None:
            self._waiting.cancelled.set()
            self._end()

    def recording(
        self, path: Path, sensor_file: Path | None = None, truth: Path | None = None
    ) -> None:
        """Open a recording with a sensor, with the present one, or with the preset that fits."""
        source, sensor = Source.of_recording(path, truth), self.sensor
        if sensor_file is not None:
            self.open(source, lambda: load_sensor(sensor_file))
        elif sensor is not None:
            self.open(source, lambda: sensor_for(path, sensor))

    def truth(self, path: Path) -> None:
        """Have the recording that is open, one of a simulation, known by its TRUTH.npz."""
        source, sensor = self.source, self.sensor
        if source is not None and source.path is not None and sensor is not None:
            self.reopen(path.name, lambda: sensor, Source.of_recording(source.path, path))
        else:
            problem = f"{path}: open the recording of that simulation first"
            self.notified.emit(UserMessage("error", problem))

    def sensor_file(self, path: Path) -> None:
        """Use the sensor of a file with the present source."""
        self.reopen(path.name, lambda: load_sensor(path))

    def use_sensor(self, sensor: Sensor) -> None:
        """Use another sensor, which is loaded already, with the present source."""
        self.reopen(sensor.name, lambda: sensor)

    def reopen(self, what: str, open_sensor: OpenSensor, source: Source | None = None) -> None:
        """Open the present source anew, or in another form, at the present frame."""
        state, source = self._state, source or self.source
        if source is not None and state.facts is not None:
            self.open(source, open_sensor, what=what, frame=state.frame, playing=state.playing)

    def nothing(self) -> None:
        """Close what is open; the sensor stays, at rest."""
        sensor = self.sensor
        if sensor is not None:
            self.open(NO_SOURCE, lambda: sensor, playing=False)

    def take(self, request: object) -> None:
        """Notice that what was asked for has come, or has failed."""
        if self._waiting is not None and request is self._waiting:
            self._end()

    def _end(self) -> None:
        self._waiting = None
        self.changed.emit("")
