"""Live frames: a robot's, a camera's, a recording's as if it were live, or simulated ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bubbleviz.live import Counters, LiveStream, open_stream, patience_s, sensor_for_source
from bubbleviz.recordings import AUTO, Frame
from bubbleviz.sensor import Sensor, load_sensor


class Stream:
    """The newest frames of a live source; a frame that nobody took in time is left out.

    A context manager; iterating gives frames until the source ends, and raises
    `StreamStoppedError` where none comes for a second after the first.

    Parameters
    ----------
    live : LiveStream
        Started.
    uri : str
        What it was opened by.
    sensor : Sensor
        Of the source.
    """

    def __init__(self, live: LiveStream, uri: str, sensor: Sensor) -> None:
        self.live, self.uri, self.sensor = live, uri, sensor

    def take(self, timeout_s: float = 0.0) -> Frame | None:
        """The newest frame that was not taken yet, waiting for one; None when none came."""
        return self.live.take(timeout_s)

    @property
    def ended(self) -> bool:
        """Whether the source has no more frames."""
        return self.live.source.link == "ended"

    @property
    def counters(self) -> Counters:
        """What arrived, what was left out, and what is wrong with it."""
        return self.live.counters()

    def sensor_or(self, sensor: str | Path | Sensor) -> Sensor:
        """The stream's sensor for `auto`, or another one."""
        return self.sensor if str(sensor) == AUTO else load_sensor(sensor)

    def __iter__(self) -> Iterator[Frame]:
        return self.live.each(self.take)

    def close(self) -> None:
        """Disconnect."""
        self.live.stop()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(source: str, sensor: str | Path | Sensor = AUTO) -> Stream:
    """Connect to a live source.

    Parameters
    ----------
    source : str
        `zenoh:tcp/HOST:7447` (ROS 2 messages, no ROS here), `realsense:[serial]`, `replay:REC`,
        `synthetic:[object]`, each with options, `scheme:place?option=value&…`.
    sensor : str, path or Sensor
        Sensor file or preset; `auto` waits for the first image and is the preset of its size.

    Returns
    -------
    Stream
        To hand to `estimate` or `track`, or to take frames from; close it, or use `with`.

    Raises
    ------
    InputError
        The source is not well-formed, or what it names is not there. A robot that does not answer
        yet is waited for.

    Examples
    --------
    >>> with bv.connect("zenoh:tcp/ROBOT:7447", "mine.toml") as stream:
    ...     for found in bv.estimate(stream):
    ...         print(found.force_n)
    """
    loaded = sensor_of(source, sensor)
    live = open_stream(source, loaded)
    live.start()
    return Stream(live, source, loaded)


def sensor_of(source: str, sensor: str | Path | Sensor) -> Sensor:
    """Sensor of a live source, found by its first image for `auto`."""
    if not isinstance(sensor, Sensor):
        sensor = sensor_for_source(source, str(sensor), patience_s(source))
    return load_sensor(sensor)


def offered(stream: LiveStream) -> str:
    """Topics that a source has, in words."""
    topics = ", ".join(topic.name for topic in stream.source.topics)
    return f"topics there: {topics}" if topics else "no topics were found"
