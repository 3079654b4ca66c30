"""From what `--source` says to a live stream."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz.frames.message_encoding import Encoding, FrameMessages
from bubbleviz.live.assembler import FrameAssembler
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sources.live_source import LiveSource
from bubbleviz.live.sources.realsense import open_realsense
from bubbleviz.live.sources.replay import Replay
from bubbleviz.live.sources.source_uri import SourceUri, parse_uri
from bubbleviz.live.sources.zenoh_session import SessionOptions
from bubbleviz.live.sources.zenoh_source import ZenohSource
from bubbleviz.live.topic_names import TopicNames
from bubbleviz.sensor import Sensor

FIRST_MESSAGE_S = 10.0
SIMULATED_S = 120.0


def patience_s(text: str) -> float:
    """How long the first message of a source may take, s: all of a simulation is made before it."""
    return SIMULATED_S if text.startswith("synthetic:") else FIRST_MESSAGE_S


def open_stream(text: str, sensor: Sensor, *, any_size: bool = False) -> LiveStream:
    """Stream of a source, not started yet.

    Parameters
    ----------
    text : str
        `scheme:place?option=value&…`, see `parse_uri`. Every scheme knows the options `depth`,
        `info`, `pressure` and `wrench` (topics), `prefix` (of the sensor's topics) and `lag` (s).
    sensor : Sensor
        Simulated by `synthetic:`; its image size is the one that counts.
    any_size : bool
        Take images of whatever size comes first: who only records needs no sensor file.

    Raises
    ------
    InputError
        The source is not well-formed, or what it names is not there.
    """
    uri = parse_uri(text)
    names = TopicNames(
        depth=uri.text_of("depth"),
        info=uri.text_of("info"),
        pressure=uri.text_of("pressure"),
        wrench=uri.text_of("wrench"),
        prefix=uri.text_of("prefix") or "",
    )
    lag_s = uri.number("lag", 0.0, -1.0, 1.0)
    source = _MAKERS[uri.scheme](uri, sensor, names)
    camera = sensor.camera
    assembler = FrameAssembler(
        names,
        size=None if any_size else (camera.width, camera.height),
        camera=DepthCamera.of(camera).intrinsics,
        lag_s=lag_s,
    )
    return LiveStream(source, assembler)


def _synthetic(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    # recording a real sensor starts without the solver that simulates one
    from bubbleviz.live.sources.synthetic_live import SyntheticLive
    from bubbleviz.simulation.live_scenes import simulation

    rate = uri.number("rate", 30.0, 0.1, 1000.0)
    frames = round(uri.number("frames", 150, 1, 100_000))
    noise = uri.number("noise", sensor.camera.noise_relative, 0.0, 0.5)
    seed = round(uri.number("seed", 0, 0, 2**31))
    ahead = uri.flag("ahead", default=True)
    encoding = cast(Encoding, uri.choice("encoding", ("32FC1", "16UC1")))
    uri.check_all_known()
    make = simulation(uri, sensor, frames, noise, rate, seed)
    messages = FrameMessages(encoding, names.prefix or "/bubble")
    return SyntheticLive(uri.text, make, rate, ahead=ahead, messages=messages)


def _replay(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    speed = uri.number("speed", 1.0, 1e-3, 1e3)
    loop = uri.flag("loop", default=False)
    uri.check_all_known()
    if not uri.place:
        raise uri.refusal("name the recording, replay:REC")
    return Replay(uri.place, speed=speed, loop=loop)


def _zenoh(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    options = SessionOptions.of(uri)
    domain = round(uri.number("domain", 0, 0, 232))
    uri.check_all_known()
    return ZenohSource(options, names, domain)


def _realsense(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    camera = sensor.camera
    rate = round(uri.number("rate", 30, 1, 300))
    loop = uri.flag("loop", default=False)
    uri.check_all_known()
    size = (camera.width, camera.height)
    return open_realsense(uri, size, rate, loop=loop, prefix=names.prefix or "/bubble")


_Maker = Callable[[SourceUri, Sensor, TopicNames], LiveSource]

_MAKERS: dict[str, _Maker] = {
    "synthetic": _synthetic,
    "replay": _replay,
    "zenoh": _zenoh,
    "realsense": _realsense,
}
