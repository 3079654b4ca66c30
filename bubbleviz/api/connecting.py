"""Live frames of a robot, a camera, a replayed recording or a simulation."""

from __future__ import annotations

from pathlib import Path

from bubbleviz.live import STOPPED_AFTER_S, LiveStream, open_stream, sensor_for_source
from bubbleviz.recordings import AUTO
from bubbleviz.sensor import Sensor, load_sensor


def connect(
    source: str,
    sensor: str | Path | Sensor = AUTO,
    *,
    timeout_s: float | None = STOPPED_AFTER_S,
) -> LiveStream:
    """Connect to a live source.

    Parameters
    ----------
    source : str
        `zenoh:tcp/HOST:7447` (ROS 2 messages, without ROS), `realsense:[serial]`, `replay:REC`,
        `synthetic:[object]`, each with options, `scheme:place?option=value&…`.
    sensor : str, path or Sensor
        Sensor file or preset; `auto` waits for the first image and takes the preset of its size.
    timeout_s : float, optional
        Longest time without a frame while iterating the stream, and in `estimate` and `track`, s;
        None waits forever.

    Returns
    -------
    LiveStream
        For `estimate` or `track`, or to read frames from; close it, or use `with`.

    Raises
    ------
    InputError
        The source is malformed, or does not exist. A robot that does not answer yet is no error.

    Examples
    --------
    >>> with bv.connect("zenoh:tcp/ROBOT:7447", "mine.toml") as stream:
    ...     for found in bv.estimate(stream):
    ...         print(found.force_n)
    """
    stream = open_stream(source, sensor_of(source, sensor), timeout_s=timeout_s)
    stream.start()
    return stream


def sensor_of(source: str, sensor: str | Path | Sensor) -> Sensor:
    """Sensor of a live source; `auto` chooses it by the first image."""
    if not isinstance(sensor, Sensor):
        sensor = sensor_for_source(source, str(sensor))
    return load_sensor(sensor)
