"""Live frames: a robot's, a camera's, a recording's as if it were live, or simulated ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bubbleviz.frames.frame import Frame
from bubbleviz.live.counters import Counters
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sources.open_stream import open_stream
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
        return self.live.source.link() == "ended"

    @property
    def counters(self) -> Counters:
        """What arrived, what was left out, and what is wrong with it."""
        return self.live.counters()

    def __iter__(self) -> Iterator[Frame]:
        return self.live.each(self.take)

    def close(self) -> None:
        """Disconnect."""
        self.live.stop()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(source: str, sensor: str | Path | Sensor) -> Stream:
    """Connect to a live source.

    Parameters
    ----------
    source : str
        `zenoh:tcp/HOST:7447` (ROS 2 messages, no ROS here), `realsense:[serial]`, `replay:REC`,
        `synthetic:[object]`, each with options, `scheme:place?option=value&…`.
    sensor : str, path or Sensor
        Sensor file or preset.

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
    loaded = load_sensor(sensor)
    live = open_stream(source, loaded)
    live.start()
    return Stream(live, source, loaded)
