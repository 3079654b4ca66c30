"""Live frames: a robot's, a camera's, a recording's as if it were live, or simulated ones."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bubbleviz.api.blas_threads import OneBlasThread
from bubbleviz.api.results import FrameResult
from bubbleviz.calibration.pressure_zero import PressureZero, zeroed
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.sensor_matching import AUTO, gas_warning
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.live.counters import Counters
from bubbleviz.live.latency import LatencyMeter
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sources.auto_sensor import sensor_for_source
from bubbleviz.live.sources.open_stream import open_stream, patience_s
from bubbleviz.pipeline import SHEAR, FrameOptions, Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor, load_sensor

if TYPE_CHECKING:
    from bubbleviz.shear.passing_texture import PassingTexture

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
"""There is a pose only where the pipeline follows an object."""
CAMERA_S = 0.5
"""How long the first frames may come without camera info before the sensor file's counts."""


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


class Watcher:
    """Solves the newest frame of a stream, over and over.

    Parameters
    ----------
    stream : LiveStream
        Started.
    pipeline : Pipeline
    zero : PressureZero or None
    options : FrameOptions, optional
    first : Frame, optional
        Taken from the stream already; solved where no newer one has come.
    texture : PassingTexture, optional
        Of the pipeline: traction with friction and slip, too.
    """

    def __init__(
        self,
        stream: LiveStream,
        pipeline: Pipeline,
        zero: PressureZero | None,
        options: FrameOptions | None = None,
        first: Frame | None = None,
        texture: PassingTexture | None = None,
    ) -> None:
        self.stream, self.pipeline, self.zero = stream, pipeline, zero
        self.texture = texture
        self._products = PRODUCTS if texture is None else PRODUCTS | SHEAR
        self._options = options
        self._first = first
        self._measured_pa: float | None = None
        self.latency = LatencyMeter()
        self.last: Result | None = None

    @classmethod
    def on(
        cls,
        stream: LiveStream,
        source: str,
        sensor: Sensor,
        options: FrameOptions | None = None,
        *,
        solver: str | None = None,
        friction: float | None = None,
        obj: RigidObject | None = None,
        start: np.ndarray | None = None,
        zero_gas: bool = True,
        shear: bool = False,
        stop: threading.Event | None = None,
    ) -> Watcher:
        """Watcher of a stream, once the first frame tells the camera.

        Parameters
        ----------
        stream : LiveStream
            Started.
        source : str
            What it was opened by.
        sensor : Sensor
        options : FrameOptions, optional
        solver, friction
            As of `bubbleviz.estimate`.
        obj : RigidObject, optional
            To track.
        start : (4, 4) array, optional
            T_B_O in the first frame.
        zero_gas : bool
            Whether the gas pressure is zeroed on the first contact-free frames.
        shear : bool
            Traction with friction and slip, too, from the stream's colour images.
        stop : Event, optional
            Ends the waiting.

        Raises
        ------
        InputError
            No depth image came, or it is not of the sensor's camera; shear was asked for and the
            estimator is not of the exact membrane.
        """
        if shear:
            stream.follow_colour()
        check = partial(stream.check_size, f"--source {source}", sensor.name)
        first = _first_frame(stream, stop or threading.Event(), patience_s(source), check)
        if first is None:
            raise InputError(f"--source {source}: no depth image arrived; {_seen(stream)}")
        pipeline = Pipeline.of(sensor, first.intrinsics, EstimatorOptions.named(solver, friction))
        pipeline.prepare(PRODUCTS)
        pipeline.follow(obj, start)
        known = PressureZero(pipeline.model.gas.P0) if zero_gas else None
        texture = _texture(pipeline, friction) if shear else None
        return cls(stream, pipeline, known, options, first, texture)

    @property
    def ended(self) -> bool:
        """Whether the source has no more frames."""
        return self.stream.source.link() == "ended"

    def step(self, timeout_s: float) -> Result | None:
        """Solve the newest frame; None when none came in time."""
        frame = self.stream.take(0.0 if self._first else timeout_s) or self._first
        self._first = None
        if frame is None:
            return None
        if self._measured_pa is None:
            self._measured_pa = frame.gas_pressure_pa
        if self.zero is not None:
            frame = zeroed(frame, self.zero, self.pipeline)
        self.last = self.pipeline.process(frame, self._products, self._options)
        if self.texture is not None:
            self.texture.take(self.last)
        self.latency.add(frame, time.time_ns())
        return self.last

    def results(self, timeout_s: float | None) -> Iterator[FrameResult]:
        """What was found in the newest frame, over and over, until the source ends."""
        one_thread = OneBlasThread()

        def step(wait_s: float) -> Result | None:
            with one_thread:
                return self.step(wait_s)

        for result in self.stream.each(step, timeout_s):
            yield FrameResult(result, self.pipeline.model)

    def warning(self) -> str:
        """What to say of a gas pressure that is not this sensor's; empty for nothing."""
        known_pa = self.pipeline.model.gas.P0
        if self.zero is None:
            return gas_warning(self._measured_pa, known_pa, "in the source")
        return gas_warning(self.zero.rest_pa, known_pa, "without contact")


def _texture(pipeline: Pipeline, friction: float | None) -> PassingTexture:
    from bubbleviz.shear.passing_texture import PassingTexture  # only for shear

    texture = PassingTexture(pipeline, friction)
    pipeline.prepare(SHEAR)
    return texture


def _first_frame(
    stream: LiveStream, stop: threading.Event, patience: float, check: Callable[[], None]
) -> Frame | None:
    """The first frame with camera info, or the first at all if none arrives."""
    began, frame = time.monotonic(), None
    deadline: float | None = None
    while not stop.is_set():
        frame = stream.take(0.1) or frame
        now, ended = time.monotonic(), stream.source.link() == "ended"
        if frame is None:
            check()
            if ended or now - began > patience:
                return None
            continue
        deadline = deadline or now + CAMERA_S
        if frame.intrinsics is not None or ended or now > deadline:
            return frame
    return frame


def _seen(stream: LiveStream) -> str:
    return stream.source.problem() or stream.counters().problem or offered(stream)


def offered(stream: LiveStream) -> str:
    """Topics that a source has, in words."""
    topics = ", ".join(topic.name for topic in stream.topics())
    return f"topics there: {topics}" if topics else "no topics were found"
