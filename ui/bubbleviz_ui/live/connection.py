"""Connecting to the sources of a live session, in the background."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from PySide6.QtCore import QObject, Signal

from bubbleviz.live import (
    LiveSession,
    LiveStream,
    SensorPlace,
    SessionPreset,
    is_simulated,
    parse_uri,
    sensor_for_source,
)
from bubbleviz_ui.engine.live_frames import LiveFrames
from bubbleviz_ui.engine.worker import Worker
from bubbleviz_ui.shell import theme

OWN_TOPICS = ("realsense", "synthetic")
"""Sources whose topics are named by bubbleviz."""


@dataclass(frozen=True)
class LiveRun:
    """A connected session: every sensor has sent a frame."""

    preset: SessionPreset
    session: LiveSession
    frames: tuple[LiveFrames, ...]  # One per sensor

    def close(self) -> None:
        """Stop the sources; a recording is completed."""
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
        self._waiting_stream: LiveStream | None = None
        self._worker = Worker("live connection")

    def start(self) -> None:
        self._worker.submit(
            self._connected, self.ready.emit, self.failed.emit, discard=LiveRun.close
        )

    def cancel(self) -> None:
        """Stop connecting; no signal is emitted any more."""
        self._worker.cancel()
        self._worker.close(0.0)

    def text(self) -> str:
        stream = self._waiting_stream
        return "starting" if stream is None else _waiting_text(stream)

    def _connected(self) -> LiveRun:
        def waiting(stream: LiveStream) -> None:
            self._waiting_stream = stream
            self._worker.progress("waiting", 0.0)  # raises `Cancelled`

        places = tuple(
            place.model_copy(
                update={"sensor": sensor_for_source(place.source, place.sensor, math.inf, waiting)}
            )
            for place in self.preset.sensors
        )
        self.preset = self.preset.model_copy(update={"sensors": places})
        self._waiting_stream = None
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
    `colour_delay_s`: Overrides the sensor file's, s.
    """
    place = SensorPlace(name="sensor", sensor=sensor, source=source, colour_delay_s=colour_delay_s)
    return SessionPreset(title=source, sensors=(place,))


def pair(first: SessionPreset, second: str) -> SessionPreset:
    """Session of one sensor and a second source with the same sensor file, drawn beside it."""
    (place,) = first.sensors
    uri = parse_uri(second)
    if uri.scheme in OWN_TOPICS and not uri.options.prefix:  # else both would have the same topics
        second += f"{'&' if '?' in second else '?'}prefix=/second"
    other = place.model_copy(
        update={"name": "second", "source": second, "colour": theme.COMPARED[1]}
    )
    sensors = (place.model_copy(update={"name": "first", "colour": theme.COMPARED[0]}), other)
    return SessionPreset(title=f"{place.source} and {second}", sensors=sensors)


def _title(preset: SessionPreset, number: int) -> str:
    place = preset.sensors[number]
    return place.source if len(preset.sensors) == 1 else f"{preset.title}, {place.name}"


def _waiting_text(stream: LiveStream) -> str:
    """Why a stream has no frame yet, and what it sent instead."""
    counters, topics = stream.counters, stream.source.topics
    if stream.source.preparing:
        return stream.source.preparing
    if counters.problem and not stream.status().problem:
        return (
            f"no depth image yet: {counters.problem}; correct its publisher, or connect to another "
            "topic (depth=)"
        )
    if topics:
        names = ", ".join(topic.name for topic in topics)
        return (
            "no depth image yet; start its publisher, or connect to another topic (depth=), of: "
            f"{names}"
        )
    return stream.status().text
