"""Live frames of a robot, a camera, a replayed recording or a simulation."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from bubbleviz.errors import InputError
from bubbleviz.live import (
    STOPPED_AFTER_S,
    Counters,
    LiveStream,
    open_stream,
    patience_s,
    sensor_for_source,
)
from bubbleviz.recordings import AUTO, Frame
from bubbleviz.sensor import Sensor, load_sensor


class Stream:
    """Newest frames of a live source; a frame that is not taken in time is skipped.

    A context manager; iterating yields frames until the source ends. It raises `InputError` if the
    first frame does not come within 10 s, and `StreamStoppedError` if a later one does not come
    within `timeout_s`; both say what is missing.

    Parameters
    ----------
    live : LiveStream
        Started.
    uri : str
        What it was opened by.
    sensor : Sensor
        Of the source.
    timeout_s : float, optional
        Longest wait for a frame while iterating, s; None waits for ever.
    """

    def __init__(
        self,
        live: LiveStream,
        uri: str,
        sensor: Sensor,
        timeout_s: float | None = STOPPED_AFTER_S,
    ) -> None:
        self.live, self.uri, self.sensor, self.timeout_s = live, uri, sensor, timeout_s

    def take(self, timeout_s: float = 0.0) -> Frame | None:
        """Newest frame that was not taken yet, waiting for one; None if none came in time."""
        return self.live.take(timeout_s)

    @property
    def ended(self) -> bool:
        """Whether the source has no more frames."""
        return self.live.source.link == "ended"

    @property
    def counters(self) -> Counters:
        """Counts of received, skipped and faulty messages."""
        return self.live.counters()

    def sensor_or(self, sensor: str | Path | Sensor) -> Sensor:
        """The stream's sensor for `auto`, or another one."""
        return self.sensor if str(sensor) == AUTO else load_sensor(sensor)

    def __iter__(self) -> Iterator[Frame]:
        deadline_s = time.monotonic() + patience_s(self.uri)

        def take(wait_s: float) -> Frame | None:
            frame = self.take(wait_s)
            silent = frame is None and self.live.status().silent_s is None and not self.ended
            if silent and self.timeout_s is not None and time.monotonic() > deadline_s:
                raise nothing_arrived(self.live, self.uri)
            return frame

        return self.live.each(take, self.timeout_s)

    def close(self) -> None:
        """Disconnect."""
        self.live.stop()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(
    source: str,
    sensor: str | Path | Sensor = AUTO,
    *,
    timeout_s: float | None = STOPPED_AFTER_S,
) -> Stream:
    """Connect to a live source.

    Parameters
    ----------
    source : str
        `zenoh:tcp/HOST:7447` (ROS 2 messages, no ROS here), `realsense:[serial]`, `replay:REC`,
        `synthetic:[object]`, each with options, `scheme:place?option=value&…`.
    sensor : str, path or Sensor
        Sensor file or preset; `auto` waits for the first image and takes the preset of its size.
    timeout_s : float, optional
        Longest wait for a frame while iterating the stream itself, s; None waits for ever.
        `estimate` and `track` have their own.

    Returns
    -------
    Stream
        To hand to `estimate` or `track`, or to take frames from; close it, or use `with`.

    Raises
    ------
    InputError
        The source is malformed, or names something that does not exist. It waits for a robot that
        does not answer yet.

    Examples
    --------
    >>> with bv.connect("zenoh:tcp/ROBOT:7447", "mine.toml") as stream:
    ...     for found in bv.estimate(stream):
    ...         print(found.force_n)
    """
    loaded = sensor_of(source, sensor)
    live = open_stream(source, loaded)
    live.start()
    return Stream(live, source, loaded, timeout_s)


def sensor_of(source: str, sensor: str | Path | Sensor) -> Sensor:
    """Sensor of a live source, found by its first image for `auto`."""
    if not isinstance(sensor, Sensor):
        sensor = sensor_for_source(source, str(sensor), patience_s(source))
    return load_sensor(sensor)


def nothing_arrived(stream: LiveStream, source: str) -> InputError:
    """The error to raise about a source without a depth image; says why where that is known."""
    seen = stream.source.problem or stream.counters().problem or offered(stream)
    return InputError(
        f"--source {source}: no depth image arrived: {seen}; check the place and the depth topic"
    )


def offered(stream: LiveStream) -> str:
    """Topics that a source has, in words."""
    topics = ", ".join(topic.name for topic in stream.source.topics)
    return f"topics found: {topics}" if topics else "no topics were found"
