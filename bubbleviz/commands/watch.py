"""The work of `bubbleviz watch`: a live source solved without a window, results out."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from bubbleviz.calibration.pressure_zero import PressureZero, zeroed
from bubbleviz.commands.stop_signals import stopped_by_signals
from bubbleviz.commands.summary import Summary
from bubbleviz.diagnostics.shear_tally import ShearSummary, ShearTally, shear_line
from bubbleviz.errors import InputError
from bubbleviz.frames.depth_topics import RESULTS
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.message_encoding import Message
from bubbleviz.frames.sensor_matching import gas_warning
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.live.latency import LatencyMeter
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.live.sinks.recorder import Recorder
from bubbleviz.live.sinks.result_messages import ResultMessages
from bubbleviz.live.sinks.zenoh_publisher import ZenohPublisher
from bubbleviz.live.source_status import STOPPED_AFTER_S
from bubbleviz.live.sources.open_stream import open_stream, patience_s
from bubbleviz.live.sources.zenoh_session import SessionOptions
from bubbleviz.pipeline import SHEAR, FrameOptions, Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor

if TYPE_CHECKING:
    from bubbleviz.shear.passing_texture import PassingTexture

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
"""There is a pose only where the pipeline follows an object."""
CAMERA_S = 0.5
"""How long the first frames may come without camera info before the sensor file's counts."""
DIAGNOSTICS_S = 1.0  # s between diagnostics, ROS's usual 1 Hz


@dataclass(frozen=True)
class WatchOptions:
    """Choices of `watch`.

    Attributes
    ----------
    out : Path or None
        Where to record what arrives and what comes out.
    publish : SessionOptions or None
        Where to publish results; None publishes nothing.
    duration_s : float or None
        From the first frame; None until ^C.
    solver : str or None
    object_name : str or None
        Object to track, a mesh file or preset.
    zero : bool
        Whether the gas pressure is zeroed on the first contact-free frames.
    shear : bool
        Traction with friction and slip, too, from the source's colour images.
    friction : float or None
        Coulomb's bound μ of the traction along the membrane over that across it.
    """

    out: Path | None = None
    publish: SessionOptions | None = None
    duration_s: float | None = None
    solver: str | None = None
    object_name: str | None = None
    zero: bool = True
    shear: bool = False
    friction: float | None = None


@dataclass(frozen=True)
class WatchSummary(Summary):
    """Summary of `watch`.

    Attributes
    ----------
    frames : int
        Frames solved.
    status : dict
        Number of them by status.
    rate_hz : float
    max_force_n : float or None
        None where no frame is to be trusted.
    latency_median_s, latency_p95_s : float or None
        Stamp, or arrival where the stamps are of another clock, to result.
    pressure_offset_pa : float or None
        Taken from the measured gas pressure.
    shear : ShearSummary or None
        None where it was not asked for.
    counters : dict
    warning : str or None
        What does not fit together, but was solved all the same.
    """

    frames: int
    status: dict[str, int]
    rate_hz: float
    max_force_n: float | None
    latency_median_s: float | None
    latency_p95_s: float | None
    pressure_offset_pa: float | None
    shear: ShearSummary | None
    counters: dict[str, Any]
    warning: str | None

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        status = ", ".join(f"{count} {name}" for name, count in self.status.items())
        lines = [f"frames   {self.frames}: {status}; {self.rate_hz:.1f} Hz"]
        if self.max_force_n is not None:
            lines.append(f"force    {self.max_force_n:.3g} N highest")
        if self.shear is not None:
            lines.append(self.shear.to_text())
        if self.latency_median_s is not None and self.latency_p95_s is not None:
            lines.append(
                f"latency  {1e3 * self.latency_median_s:.1f} ms median, "
                f"{1e3 * self.latency_p95_s:.1f} ms p95"
            )
        if self.pressure_offset_pa is not None:
            lines.append(f"zero     {self.pressure_offset_pa:+.1f} Pa taken from the gas pressure")
        return "\n".join(lines)


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
        *,
        solver: str | None = None,
        obj: RigidObject | None = None,
        start: np.ndarray | None = None,
        zero: bool = True,
        options: FrameOptions | None = None,
        stop: threading.Event | None = None,
        shear: bool = False,
        friction: float | None = None,
    ) -> Watcher:
        """Watcher of a stream, once the first frame tells the camera.

        Parameters
        ----------
        stream : LiveStream
            Started.
        source : str
            What it was opened by.
        sensor : Sensor
        solver : str, optional
        obj : RigidObject, optional
            To track.
        start : (4, 4) array, optional
            T_B_O in the first frame.
        zero : bool
            Whether the gas pressure is zeroed on the first contact-free frames.
        options : FrameOptions, optional
        stop : Event, optional
            Ends the waiting.
        shear : bool
            Traction with friction and slip, too, where the stream's colour images are followed.
        friction : float, optional
            Coulomb's bound μ of the traction along the membrane over that across it.

        Raises
        ------
        InputError
            No depth image came, or it is not of the sensor's camera; shear was asked for and the
            estimator is not of the exact membrane.
        """
        check = partial(stream.check_size, f"--source {source}", sensor.name)
        first = _first_frame(stream, stop or threading.Event(), patience_s(source), check)
        if first is None:
            raise InputError(f"--source {source}: no depth image arrived; {_seen(stream)}")
        pipeline = Pipeline.of(sensor, first.intrinsics, EstimatorOptions.named(solver, friction))
        pipeline.prepare(PRODUCTS)
        pipeline.follow(obj, start)
        known = PressureZero(pipeline.model.gas.P0) if zero else None
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

    def warning(self) -> str:
        """What to say of a gas pressure that is not this sensor's; empty for nothing."""
        known_pa = self.pipeline.model.gas.P0
        if self.zero is None:
            return gas_warning(self._measured_pa, known_pa, "in the source")
        return gas_warning(self.zero.rest_pa, known_pa, "without contact")


def watch_source(source: str, sensor: Sensor, options: WatchOptions) -> WatchSummary:
    """Solve a live source until the duration is over, the source ends, or ^C.

    Raises
    ------
    InputError
        The source, the file or the endpoint cannot be opened, or no depth image came.
    """
    with ExitStack() as stack:
        stop = stack.enter_context(stopped_by_signals())
        stream = open_stream(source, sensor)
        obj = None if options.object_name is None else load_object(options.object_name)
        recorder = _recorder(stack, stream, options.out)
        if options.shear:
            stream.follow_colour()
        publisher = _publisher(stack, options.publish)
        stack.enter_context(stream)
        watcher = Watcher.on(
            stream,
            source,
            sensor,
            solver=options.solver,
            obj=obj,
            zero=options.zero,
            stop=stop,
            shear=options.shear,
            friction=options.friction,
        )
        out = _Out(ResultMessages(watcher.pipeline.mesh, RESULTS), publisher, recorder)
        return _watch(watcher, out, stop, options.duration_s)


class _Out:
    """Where messages of results go."""

    def __init__(
        self,
        messages: ResultMessages,
        publisher: ZenohPublisher | None,
        recorder: Recorder | None,
    ) -> None:
        self.messages, self._publisher, self._recorder = messages, publisher, recorder

    def send(self, message: Message) -> None:
        topic, kind, payload, stamp = message
        if self._publisher is not None:
            self._publisher.put(topic, kind, payload, stamp)
        if self._recorder is not None:
            self._recorder.push(RawMessage(topic, kind, payload, stamp, time.time_ns()))


def _watch(watcher: Watcher, out: _Out, stop: Any, duration_s: float | None) -> WatchSummary:
    statuses: Counter[str] = Counter()
    forces: list[float] = []
    shear = None if watcher.texture is None else ShearTally()
    began = told = time.monotonic()
    silent = False
    with tqdm(unit=" frames", disable=None, file=sys.stderr) as bar:  # only on a terminal
        while not stop.is_set():
            if duration_s is not None and time.monotonic() - began >= duration_s:
                break
            ended = watcher.ended  # looked at first: a frame may come before the end is seen
            result = watcher.step(0.1)
            if ended and result is None:
                break
            if result is not None and result.estimate is not None and result.patch is not None:
                statuses[result.estimate.status] += 1
                trusted = result.trusted_patch
                if trusted is not None:
                    forces.append(float(np.linalg.norm(trusted.force_n)))
                if shear is not None:
                    shear.add(result)
                for message in out.messages.of(result):
                    out.send(message)
                bar.update()
            silent = _tell_silence(watcher.stream, silent)
            if time.monotonic() - told >= DIAGNOSTICS_S:
                told = time.monotonic()
                status, counters = watcher.stream.status(), watcher.stream.counters()
                out.send(out.messages.diagnostics(time.time_ns(), status, counters, watcher.last))
                newest = (_force_text(watcher.last), *_shear_texts(watcher), status.text)
                bar.set_postfix_str(", ".join(filter(None, newest)))
    elapsed = time.monotonic() - began
    latency = watcher.latency.report()
    return WatchSummary(
        frames=statuses.total(),
        status=dict(statuses),
        rate_hz=statuses.total() / elapsed,
        max_force_n=max(forces, default=None),
        latency_median_s=None if latency is None else latency.median_s,
        latency_p95_s=None if latency is None else latency.p95_s,
        pressure_offset_pa=None if watcher.zero is None else watcher.zero.offset_pa,
        shear=None if shear is None else shear.summary(_reference(watcher)),
        counters=watcher.stream.counters().as_dict(),
        warning=watcher.warning() or None,
    )


def _tell_silence(stream: LiveStream, told: bool) -> bool:
    """Say, once an outage, that no depth images come; whether they still do not."""
    silent_s = stream.status().silent_s or 0.0
    if silent_s < STOPPED_AFTER_S or stream.source.link() == "ended":
        return False
    if not told:
        said = f"bubbleviz: warning: {stream.silence()}; check the camera and its connection"
        tqdm.write(f"{said}; waiting for the next image", file=sys.stderr)
    return True


def _force_text(result: Result | None) -> str:
    """Force of the newest frame, or why there is none."""
    if result is None or result.estimate is None:
        return ""
    patch = result.trusted_patch
    return result.estimate.status if patch is None else f"{np.linalg.norm(patch.force_n):.2f} N"


def _texture(pipeline: Pipeline, friction: float | None) -> PassingTexture:
    from bubbleviz.shear.passing_texture import PassingTexture  # only for shear

    texture = PassingTexture(pipeline, friction)
    pipeline.prepare(SHEAR)
    return texture


def _shear_texts(watcher: Watcher) -> tuple[str, ...]:
    """Shear of the newest frame, and what it is measured against while that is not there."""
    if watcher.texture is None or watcher.last is None:
        return ()
    return (shear_line(watcher.last), watcher.texture.words)


def _reference(watcher: Watcher) -> str:
    return "" if watcher.texture is None else watcher.texture.words


def _first_frame(
    stream: LiveStream, stop: Any, patience: float, check: Callable[[], None]
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
    problem = stream.source.problem() or stream.counters().problem
    if problem:
        return problem
    offered = ", ".join(topic.name for topic in stream.topics())
    return f"topics there: {offered}" if offered else "no topics were found"


def _recorder(stack: ExitStack, stream: LiveStream, out: Path | None) -> Recorder | None:
    if out is None:
        return None
    recorder = Recorder()
    recorder.start(out)

    def finish() -> None:
        status = recorder.stop()
        if status.problem:
            raise InputError(status.problem)

    stack.callback(finish)
    recorder.listen_to(stream)
    return recorder


def _publisher(stack: ExitStack, place: SessionOptions | None) -> ZenohPublisher | None:
    return None if place is None else stack.enter_context(ZenohPublisher(place))
