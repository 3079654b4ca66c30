"""Opening of sources and sensors, and reopening with other options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from bubbleviz.errors import InputError
from bubbleviz.files import SYNTHETIC_SENSOR
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.engine.solver import Opened, OpenRequest
from bubbleviz_ui.engine.source import NO_SOURCE, PlacedSensor, Source, sensor_for
from bubbleviz_ui.model.demand import Demand
from bubbleviz_ui.model.session_state import SessionState

if TYPE_CHECKING:
    from bubbleviz.inverse import EstimatorOptions
    from bubbleviz.sensor import Sensor
    from bubbleviz_ui.engine.worker import Failed

    OpenSensor = Callable[[], Sensor]


class OtherCameraError(InputError):
    """A sensor file that is for images of another size than the open source has."""

    def __init__(self, message: str, sensor: Sensor) -> None:
        super().__init__(message)
        self.sensor = sensor


class Opening(QObject):
    """Opens sources in the solver thread; the current one stays open until that succeeds.

    `ask`: Passes a request to the solver thread.
    """

    changed = Signal(str)  # Progress text; empty when opening has ended
    about_to_open = Signal(object)  # An `OpenRequest`, which a receiver may cancel

    def __init__(self, state: SessionState, ask: Callable[[OpenRequest], None]) -> None:
        super().__init__()
        self._state, self._ask = state, ask
        self.current: Opened | None = None
        self.group: tuple[PlacedSensor, ...] = ()  # Opened together; empty: one alone
        self._other_camera: Sensor | None = None  # the last one given that did not fit the source
        self._waiting: OpenRequest | None = None
        self._then: Callable[[Failed | None], None] = lambda _: None

    @property
    def sensor(self) -> Sensor | None:
        """The sensor in use; None before the first."""
        return None if self.current is None else self.current.sensor

    @property
    def source(self) -> Source | None:
        """The open source; None before the first."""
        return None if self.current is None else self.current.request.source

    @property
    def busy(self) -> bool:
        """Whether a source is being opened."""
        return self._waiting is not None

    @property
    def options(self) -> EstimatorOptions | None:
        """Options of the open source, or of the one being opened; None before the first."""
        if self._waiting is not None:
            return self._waiting.options
        return None if self.current is None else self.current.request.options

    def open(
        self,
        source: Source,
        open_sensor: OpenSensor,
        *,
        what: str = "",  # Name in the progress text; by default the source's title
        frame: int = 0,
        playing: bool = True,
        group: tuple[PlacedSensor, ...] = (),  # As in `OpenRequest`
        before: Callable[[], None] | None = None,
        then: Callable[[Failed | None], None] = lambda _: None,
    ) -> bool:
        """Open a source with a sensor in the solver thread; False if a receiver cancelled it.

        `before` is called unless it was cancelled; it may change settings. `then` is called once it
        is open, or has failed.
        """
        request = OpenRequest(
            source=source,
            open_sensor=open_sensor,
            frame=frame,
            demand=Demand.of(self._state.settings),
            playing=playing,
            group=group,
        )
        self.about_to_open.emit(request)
        if request.cancelled.is_set():
            return False
        if before is not None:
            before()
        self.cancel()
        settings = self._state.settings
        demand, options = Demand.of(settings), settings.options
        request = replace(request, demand=demand, options=options)
        self._waiting, self._then = request, then
        self._ask(request)
        self.changed.emit(
            "Closing …" if source is NO_SOURCE else f"Opening {what or source.title} …"
        )
        return True

    def open_group(self, sensors: Sequence[PlacedSensor]) -> bool:
        """Open sensors together; the panels show the first. Returns as `open` does."""
        first, group = sensors[0], tuple(sensors) if len(sensors) > 1 else ()
        return self.open(first.source, first.open_sensor, group=group)

    def cancel(self) -> None:
        """Cancel the pending request; the solver stops at its next step."""
        if self._waiting is not None:
            self._waiting.cancelled.set()
            self._end()

    def open_recording(
        self,
        path: Path,
        sensor_file: Path | None = None,
        truth: Path | None = None,
        depth_topic: str | None = None,
    ) -> None:
        """Open a recording with a sensor file, else a sensor given before or a matching preset."""
        source = Source.of_recording(path, truth, depth_topic)
        self.open(source, self.sensor_of(path, sensor_file, depth_topic))

    def sensor_of(
        self, path: Path | None, name: str | Path | None = None, depth_topic: str | None = None
    ) -> OpenSensor:
        """Opens a sensor file or preset, else the sensor for a recording, else the one in use.

        The sensor for a recording is one that was in use before, or a preset.
        """
        known = [each for each in (self.sensor, self._other_camera) if each is not None]
        if name is not None or not (known or path):
            return partial(load_sensor, name or SYNTHETIC_SENSOR)
        if path is None:
            return lambda: known[0]
        return partial(sensor_for, path, *known, depth_topic=depth_topic)

    def reload(self) -> None:
        """Read recording and sensor again from their files."""
        source, sensor = self.source, self.sensor
        if source is not None and sensor is not None:
            file = sensor.resolve(sensor.file)
            from_file = bool(sensor.file) and file.exists()
            again = replace(source) if source.path is not None else source
            self.reopen("", partial(load_sensor, file) if from_file else lambda: sensor, again)

    def use_ground_truth(self, path: Path) -> None:
        """Reopen the simulated recording that is open with its TRUTH.npz."""
        source, sensor = self.source, self.sensor
        if source is not None and source.path is not None and sensor is not None:
            truth = Source.of_recording(source.path, path, source.depth_topic)
            self.reopen(path.name, lambda: sensor, truth)
        else:
            problem = f"{path}: no recording is open; first open that of the simulation"
            self._state.messages.add("error", problem)

    def open_sensor_file(self, path: Path) -> None:
        """Use the sensor of a file with the current source, or with the next one of its camera."""
        own = self.sensor

        def open_sensor() -> Sensor:
            sensor = load_sensor(path)
            if own is not None and _size(sensor) != _size(own):
                raise OtherCameraError(
                    f"{path.name} is for images of {_size(sensor)} pixels, the sensor in use for "
                    f"{_size(own)}; open a recording of, or connect to, a camera with that size to "
                    "use it",
                    sensor,
                )
            return sensor

        self.reopen(path.name, open_sensor)

    def use_sensor(self, sensor: Sensor) -> None:
        """Use another sensor with the current source."""
        self.reopen(sensor.name, lambda: sensor)

    def reopen(self, what: str, open_sensor: OpenSensor, source: Source | None = None) -> None:
        """Open the current source again, or `source` in its place, at the current frame."""
        state, source = self._state, source or self.source
        if source is not None:
            self.open(
                source,
                open_sensor,
                what=what,
                frame=state.frame,
                playing=state.playing,
                group=self.group,
            )

    def close_source(self) -> None:
        """Close the source; the sensor stays, at rest."""
        sensor = self.sensor
        if sensor is not None:
            self.open(NO_SOURCE, lambda: sensor, playing=False)

    def finish(self, request: object, failed: Failed | None = None) -> None:
        """A request has succeeded, or failed."""
        if failed is not None and isinstance(failed.error, OtherCameraError):
            self._other_camera = failed.error.sensor
        if self._waiting is not None and request is self._waiting:
            then = self._then
            self._end()
            then(failed)

    def _end(self) -> None:
        self._waiting = None
        self.changed.emit("")


def _size(sensor: Sensor) -> str:
    return f"{sensor.camera.width}×{sensor.camera.height}"
