"""The sensor preset that fits a live source, by the size of its images."""

from __future__ import annotations

import time
from collections.abc import Callable

from bubbleviz.errors import InputError
from bubbleviz.files.defaults import SYNTHETIC_SENSOR
from bubbleviz.frames.sensor_matching import AUTO, preset_of_size
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sources.open_stream import open_stream
from bubbleviz.live.sources.source_uri import parse_uri
from bubbleviz.sensor import load_sensor

LOOK_S = 0.1  # s between calls of `waiting`


def sensor_for_source(
    text: str,
    name: str,
    patience_s: float = float("inf"),
    waiting: Callable[[LiveStream], None] = lambda _: None,
) -> str:
    """Name of the sensor for a live source: as given, or for `auto` the one preset that fits.

    The source is opened for its first image, and closed again.

    Parameters
    ----------
    text : str
        As `--source`.
    name : str
    patience_s : float
        How long the first image may take, s.
    waiting : callable
        Called with the stream now and then until the image is there; what it raises ends the
        waiting.

    Raises
    ------
    InputError
        The source cannot be opened, no image came, or its size is of no or of several presets.
    """
    uri = parse_uri(text)
    if name != AUTO:
        return name
    if uri.scheme == "synthetic":  # any sensor fits: it is what is simulated
        return SYNTHETIC_SENSOR
    if uri.scheme == "realsense":
        raise uri.refusal("its images have the size that the sensor file asks for; give --sensor")
    with open_stream(text, load_sensor(SYNTHETIC_SENSOR), any_size=True) as stream:
        return preset_of_size(_image_size(stream, text, patience_s, waiting), f"--source {text}")


def _image_size(
    stream: LiveStream, text: str, patience_s: float, waiting: Callable[[LiveStream], None]
) -> tuple[int, int]:
    deadline = time.monotonic() + patience_s
    while (frame := stream.take(LOOK_S)) is None:
        waiting(stream)
        if stream.source.link() == "ended" or time.monotonic() > deadline:
            why = stream.source.problem() or stream.counters().problem or "give --sensor"
            raise InputError(f"--source {text}: no depth image arrived; {why}")
    height, width = frame.depth_m.shape
    return width, height
