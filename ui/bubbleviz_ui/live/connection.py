"""Bringing a live session up, however long the robot takes, without anybody waiting for it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from PySide6.QtCore import QObject, Signal

from bubbleviz.live import (
    LiveSession,
    LiveStream,
    SensorPlace,
    SessionPreset,
    is_simulated,
    sensor_for_source,
)
from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.live.live_frames import LiveFrames


@dataclass(frozen=True)
class LiveRun:
    """A session whose sensors all have sent a frame."""

    preset: SessionPreset
    session: LiveSession  # Entered
    frames: tuple[LiveFrames, ...]  # Of each sensor

    def close(self) -> None:
        """Stop the sources; a recording ends whole."""
        self.session.__exit__()
        for source in self.frames:
            source.end()


class Connection(QObject):
    """Starts the sources of a session and waits for the first frame of each."""

    ready = Signal(object)  # A `LiveRun`
    failed = Signal(object)  # A `Failed`

    def __init__(self, preset: SessionPreset, pre_roll_s: float) -> None:
        super().__init__()
        self.preset = preset
        self._pre_roll_s = pre_roll_s
        self._awaited: LiveStream | None = None
        self._worker = Worker("live connection")

    def start(self) -> None:
        """Begin."""
        self._worker.submit(
            self._connected, self.ready.emit, self.failed.emit, discard=LiveRun.close
        )

    def cancel(self) -> None:
        """Give up; nothing is emitted any more, and the sources are stopped soon."""
        self._worker.cancel()

    def wait(self, timeout_s: float) -> None:
        """Wait until the thread is gone."""
        self._worker.close(timeout_s)

    def text(self) -> str:
        """How far it is, in a few words."""
        stream = self._awaited
        return "starting" if stream is None else _waiting_for(stream)

    def _connected(self) -> LiveRun:
        def waiting(stream: LiveStream) -> None:
            self._awaited = stream
            self._worker.progress("waiting", 0.0)  # cancelled by this

        self.preset = _with_sensors(self.preset, waiting)
        self._awaited = None
        session = LiveSession(self.preset, self._pre_roll_s)
        session.__enter__()
        frames = tuple(
            LiveFrames(
                _title(self.preset, k),
                each.stream,
                each.zero,
                simulated=is_simulated(each.place.source),
                paired=len(session.sensors) > 1,
            )
            for k, each in enumerate(session.sensors)
        )
        try:
            first = [
                each.stream.first_frame(math.inf, partial(waiting, each.stream))
                for each in session.sensors
            ]
        except BaseException:
            session.__exit__()
            raise
        epoch_ns = min(frame.arrival_ns for frame in first)
        for source, frame in zip(frames, first, strict=True):
            source.begin(epoch_ns, frame)
        return LiveRun(self.preset, session, frames)


def single(source: str, sensor: str, colour_delay_s: float | None = None) -> SessionPreset:
    """Session of one sensor.

    `sensor`: Sensor file or preset.
    `colour_delay_s`: In place of the sensor file's, s.
    """
    place = SensorPlace(name="sensor", sensor=sensor, source=source, colour_delay_s=colour_delay_s)
    return SessionPreset(title=source, sensors=(place,))


def _title(preset: SessionPreset, number: int) -> str:
    place = preset.sensors[number]
    return place.source if len(preset.sensors) == 1 else f"{preset.title}, {place.name}"


def _with_sensors(preset: SessionPreset, waiting: Callable[[LiveStream], None]) -> SessionPreset:
    """The preset with the names of sensors that were left to the size of the images."""
    places = tuple(
        place.model_copy(
            update={"sensor": sensor_for_source(place.source, place.sensor, math.inf, waiting)}
        )
        for place in preset.sensors
    )
    return preset.model_copy(update={"sensors": places})


def _waiting_for(stream: LiveStream) -> str:
    """What a stream without a frame so far is waited for, and what came instead."""
    counters, topics = stream.counters, stream.source.topics
    if counters.problem and not stream.status().problem:
        return f"no depth image yet: {counters.problem}"
    if topics:
        return f"no depth image yet; topics: {', '.join(topic.name for topic in topics)}"
    return stream.status().text
