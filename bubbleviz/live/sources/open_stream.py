"""Opening a live stream from a source URI."""

from __future__ import annotations

from collections.abc import Callable

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.frames.message_encoding import FrameMessages
from bubbleviz.live.assembler import FrameAssembler
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sources.live_source import LiveSource
from bubbleviz.live.sources.replay import Replay
from bubbleviz.live.sources.source_uri import SourceUri, SyntheticOptions, parse_uri
from bubbleviz.live.topic_names import TopicNames
from bubbleviz.sensor import Sensor

FIRST_MESSAGE_S = 10.0
SIMULATED_S = 120.0
"""Patience with a robot's network, and with a simulation that is made before it is sent."""
DEFAULT_PREFIX = "/bubble"
"""Of the topics of a source that has none itself."""


def is_simulated(text: str) -> bool:
    """Tell a simulation from what measures, or has measured."""
    return text.strip().startswith("synthetic:")


def patience_s(text: str) -> float:
    """How long the first message of a source may take, s: all of a simulation is made before it."""
    return SIMULATED_S if is_simulated(text) else FIRST_MESSAGE_S


def open_stream(text: str, sensor: Sensor, *, any_size: bool = False) -> LiveStream:
    """Stream of a source, not started yet.

    Parameters
    ----------
    text : str
        `scheme:place?option=value&…`, see `parse_uri`.
    sensor : Sensor
        Simulated by `synthetic:`; its image size is the one that counts.
    any_size : bool
        Accept images of any size: recording alone needs no sensor file.

    Raises
    ------
    InputError
        The source is not well-formed, or what it names is not there.
    """
    uri = parse_uri(text)
    options = uri.options
    names = TopicNames(
        options.depth,
        options.info,
        options.pressure,
        options.wrench,
        options.colour,
        options.prefix,
    )
    source = _MAKERS[uri.scheme](uri, sensor, names)
    camera = sensor.camera
    assembler = FrameAssembler(
        names,
        size=None if any_size else (camera.width, camera.height),
        camera=DepthCamera.of(camera).intrinsics,
        lag_s=options.lag,
        colour_delay_s=camera.colour_delay_s,
    )
    return LiveStream(source, assembler)


def _synthetic(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    # recording a real sensor starts without the solver that simulates one
    from bubbleviz.live.sources.synthetic_live import SyntheticLive
    from bubbleviz.simulation.live_scenes import simulation

    options: SyntheticOptions = uri.options
    noise = sensor.camera.noise_relative if options.noise is None else options.noise
    make = simulation(uri.place, sensor, options.frames, noise, options.rate, options.seed)
    messages = FrameMessages(options.encoding, names.prefix or DEFAULT_PREFIX)
    return SyntheticLive(uri.text, make, options.rate, ahead=options.ahead, messages=messages)


def _replay(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    if not uri.place:
        raise uri.refusal("name the recording, replay:REC")
    return Replay(uri.place, speed=uri.options.speed, loop=uri.options.loop)


def _zenoh(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    # the window starts without the network's library
    from bubbleviz.live.sources.zenoh_session import SessionOptions
    from bubbleviz.live.sources.zenoh_source import ZenohSource

    return ZenohSource(SessionOptions.of(uri), names, uri.options.domain)


def _realsense(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    from bubbleviz.live.sources.realsense import open_realsense  # the window starts without

    size = (sensor.camera.width, sensor.camera.height)
    return open_realsense(uri, size, names.prefix or DEFAULT_PREFIX)


_Maker = Callable[[SourceUri, Sensor, TopicNames], LiveSource]

_MAKERS: dict[str, _Maker] = {
    "synthetic": _synthetic,
    "replay": _replay,
    "zenoh": _zenoh,
    "realsense": _realsense,
}
