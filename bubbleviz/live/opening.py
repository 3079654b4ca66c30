"""Opening live streams from URIs and session presets; choice of the sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from bubbleviz.camera import DepthCamera
from bubbleviz.errors import check_given
from bubbleviz.files import (
    SYNTHETIC_SENSOR,
    checked,
    named_file,
    presets_folder,
    read_toml,
    transform,
)
from bubbleviz.live.assembler import FrameAssembler
from bubbleviz.live.live_source import LiveSource, SourceUri, SyntheticOptions, parse_uri
from bubbleviz.live.live_stream import STOPPED_AFTER_S, LiveStream
from bubbleviz.live.recorder import Recorder
from bubbleviz.live.replay import FramesLive, Replay
from bubbleviz.live.topic_names import TopicNames
from bubbleviz.plugins import plugin
from bubbleviz.recordings import AUTO, FrameMessages, preset_of_size
from bubbleviz.sensor import (
    ColourDelay,
    Section,
    Sensor,
    UnitQuaternion,
    Vector3,
    load_sensor,
    with_colour_delay,
)
from bubbleviz.zeros import PressureZero

FIRST_MESSAGE_S = 10.0
SIMULATED_S = 120.0
"""Timeout for the first message of a simulation, which is computed before it is sent."""
DEFAULT_PREFIX = "/bubble"  # of the topics of a source that has none itself


def is_simulated(text: str) -> bool:
    """Whether a source is a simulation, not a measurement."""
    return text.strip().startswith("synthetic:")


def open_stream(
    text: str,  # `scheme:place?option=value&…`, see `parse_uri`
    sensor: Sensor,  # simulated by `synthetic:`; images must have its size
    *,
    any_size: bool = False,  # accept images of any size: recording alone needs no sensor file
    timeout_s: float | None = STOPPED_AFTER_S,  # as of `LiveStream`
) -> LiveStream:
    """Stream of a source, not started yet.

    Raises InputError: the source is not well-formed, or does not exist.
    """
    check_given("timeout_s", timeout_s, 0.0)
    uri = parse_uri(text)
    options = uri.options
    chosen = {"depth", "info", "pressure", "wrench", "colour", "prefix"}
    names = TopicNames(**options.model_dump(include=chosen))
    source = _MAKERS.get(uri.scheme, _plugged)(uri, sensor, names)
    camera = sensor.camera
    assembler = FrameAssembler(
        names,
        size=None if any_size else camera.size,
        camera=DepthCamera.of(camera).intrinsics,
        lag_s=options.lag,
        colour_delay_s=camera.colour_delay_s,
    )
    patience_s = SIMULATED_S if is_simulated(text) else FIRST_MESSAGE_S
    return LiveStream(
        source, sensor, assembler, uri=text, patience_s=patience_s, timeout_s=timeout_s
    )


def _synthetic(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    # recording a real sensor starts without the solver that simulates one
    from bubbleviz.live.replay import SyntheticLive
    from bubbleviz.simulation import simulation

    options: SyntheticOptions = uri.options
    noise = sensor.camera.noise_relative if options.noise is None else options.noise
    make = simulation(uri.place, sensor, options.frames, noise, options.rate, options.seed)
    messages = FrameMessages(options.encoding, names.prefix or DEFAULT_PREFIX)
    return SyntheticLive(uri.text, make, options.rate, ahead=options.ahead, messages=messages)


def _replay(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    if not uri.place:
        raise uri.refusal("give the recording: replay:REC")
    return Replay(uri.place, speed=uri.options.speed, loop=uri.options.loop)


def _zenoh(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    # the window starts without the network's library
    from bubbleviz.live.zenoh_session import SessionOptions
    from bubbleviz.live.zenoh_source import ZenohSource

    return ZenohSource(SessionOptions.of(uri), names, uri.options.domain)


def _realsense(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    from bubbleviz.live.realsense import open_realsense  # the window starts without

    return open_realsense(uri, sensor.camera.size, names.prefix or DEFAULT_PREFIX)


def _plugged(uri: SourceUri, sensor: Sensor, names: TopicNames) -> LiveSource:
    frames, options = plugin("sources", uri.scheme), uri.options.model_extra
    messages = FrameMessages(prefix=names.prefix or DEFAULT_PREFIX)
    return FramesLive(uri.text, partial(frames, uri.place, options), messages)


_Maker = Callable[[SourceUri, Sensor, TopicNames], LiveSource]

_MAKERS: dict[str, _Maker] = {
    "synthetic": _synthetic,
    "replay": _replay,
    "zenoh": _zenoh,
    "realsense": _realsense,
}


# The sensor preset that fits a live source, by the size of its images.


def sensor_for_source(
    text: str,  # as `--source`
    name: str,
    # timeout for the first image, s; default: the source's
    patience_s: float | None = None,
    # called with the stream regularly while waiting; an exception in it ends the wait
    waiting: Callable[[LiveStream], object] = lambda _: None,
) -> str:
    """Name of the sensor for a live source: as given, or for `auto` the one preset that fits.

    The source is opened for its first image, and closed again.

    Raises InputError: the source cannot be opened, no image came, or its size is of no or of
    several presets.
    """
    uri = parse_uri(text)
    if name != AUTO:
        return name
    if uri.scheme == "synthetic":  # any sensor fits, as it is the one simulated
        return SYNTHETIC_SENSOR
    if uri.scheme == "realsense":
        raise uri.refusal(
            "the sensor of a RealSense camera is not chosen automatically; give it with --sensor"
        )
    with open_stream(text, load_sensor(SYNTHETIC_SENSOR), any_size=True) as stream:
        first = stream.first_frame(patience_s, lambda: waiting(stream), camera_s=0.0)
    height, width = first.depth_m.shape
    return preset_of_size((width, height), text)


# Session presets: which sensors are shown at once, and where they are in the world.


class SensorPlace(Section):
    """One sensor of a session."""

    name: str = Field(min_length=1)  # also the prefix of its topics
    sensor: str  # sensor file or preset
    source: str  # as `--source`
    # position_m, quaternion_xyzw: T_W_B
    position_m: Vector3 = (0.0, 0.0, 0.0)
    quaternion_xyzw: UnitQuaternion = (0.0, 0.0, 0.0, 1.0)
    # of its layers, as #rrggbb
    colour: str = Field(default="#4f8fd0", pattern="^#[0-9a-fA-F]{6}$")
    # instead of the sensor file's `camera.colour_delay_s`
    colour_delay_s: ColourDelay | None = None

    @property
    def T_W_B(self) -> np.ndarray:
        """Pose of the bubble in the world, (4, 4)."""
        return transform(self.position_m, self.quaternion_xyzw)


class SessionPreset(Section):
    """A session file: one or two sensors."""

    schema_version: Literal[1] = 1
    title: str = Field(min_length=1)
    sensors: tuple[SensorPlace, ...] = Field(min_length=1, max_length=2)


def load_session(name: str | Path) -> SessionPreset:
    """Session of a TOML file or, where there is no such file, the preset of that name.

    Raises InputError: there is none, it is not TOML, or breaks the schema; names the key.
    """
    path = named_file(name, presets_folder("sessions"), "session")
    return checked(SessionPreset, read_toml(path), path, "session")


# One or two sensors at once, each with its own source; one recorder, one clock.


@dataclass(frozen=True)
class LiveSensor:
    """A sensor of a session, independent of the other."""

    place: SensorPlace  # name, colour and T_W_B
    sensor: Sensor
    stream: LiveStream
    zero: PressureZero  # for the solver of this sensor's frames


class LiveSession:
    """The sensors of a session preset, live; a context manager.

    Raises InputError: a sensor file or a source does not exist.
    """

    def __init__(
        self,
        preset: SessionPreset,
        pre_roll_s: float = 0.0,  # seconds before recording starts that are recorded, too
    ) -> None:
        self.recorder = Recorder(pre_roll_s)  # gets every message of every sensor
        self.sensors = tuple(_open(place) for place in preset.sensors)
        for each in self.sensors:
            self.recorder.listen_to(each.stream)

    def __enter__(self) -> LiveSession:
        try:
            for each in self.sensors:
                each.stream.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for each in self.sensors:
            each.stream.close()
        if self.recorder.recording:
            self.recorder.stop()


def _open(place: SensorPlace) -> LiveSensor:
    sensor = with_colour_delay(load_sensor(place.sensor), place.colour_delay_s)
    zero = PressureZero(sensor.pneumatics)
    return LiveSensor(place, sensor, open_stream(place.source, sensor), zero)
