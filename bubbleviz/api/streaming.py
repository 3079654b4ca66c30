"""Live sources without a window: solved, recorded and published until they end, or ^C."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from bubbleviz.api.connecting import Watcher, offered, sensor_of
from bubbleviz.api.summary import Summary, counted
from bubbleviz.diagnostics.shear_tally import ShearSummary, ShearTally, shear_line
from bubbleviz.errors import InputError
from bubbleviz.files.defaults import SYNTHETIC_SENSOR
from bubbleviz.files.output_files import refuse_existing, set_aside
from bubbleviz.frames.depth_topics import RESULTS
from bubbleviz.frames.message_encoding import Message
from bubbleviz.frames.sensor_matching import AUTO
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.live.sinks.recorder import Recorder, RecorderStatus
from bubbleviz.live.sinks.result_messages import ResultMessages
from bubbleviz.live.sinks.zenoh_publisher import ZenohPublisher
from bubbleviz.live.source_status import STOPPED_AFTER_S
from bubbleviz.live.sources.live_source import OfferedTopic
from bubbleviz.live.sources.open_stream import open_stream, patience_s
from bubbleviz.live.sources.zenoh_credentials import Credentials
from bubbleviz.live.sources.zenoh_keys import Layout
from bubbleviz.live.sources.zenoh_session import ROUTER, SessionOptions
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, load_sensor, with_colour_delay
from bubbleviz.wording import count_of

_LOOK_S = 0.1  # s between looks at the stream; chosen
_DIAGNOSTICS_S = 1.0  # s between diagnostics, ROS's usual 1 Hz
_LINGER_S = 0.5
"""How long the session stays open after the last message, so that it goes out."""
_SETTLE_S = 0.3
"""How long no more subscriptions must come before the first message: one subscriber has several."""


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
        lines = [f"frames   {self.frames}: {counted(self.status)}; {self.rate_hz:.1f} Hz"]
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


def watch(
    source: str,
    sensor: str | Path | Sensor = AUTO,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
    listen: str | None = None,
    connect: str | None = None,
    duration_s: float | None = None,
    object: str | Path | RigidObject | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    shear: bool = False,
    colour_delay_s: float | None = None,
    **credentials: str | None,
) -> WatchSummary:
    """Solve a live source until the duration is over, it ends, or ^C.

    To get the results in Python: `connect`, then `estimate` or `track`.

    Parameters
    ----------
    source, sensor
        As of `connect`.
    out : path, optional
        Recording of what arrives and what comes out; `overwrite` replaces it where it exists.
    listen, connect : str, optional
        Publish results over Zenoh: subscribers connect to this endpoint, or through this router.
    duration_s : float, optional
        From the first frame, s.
    object : str, path or RigidObject, optional
        To track: a mesh file or preset.
    solver, friction, zero_gas, shear, colour_delay_s
        As of `estimate`; the gas pressure is zeroed, and shear measured, on the first contact-free
        frames.
    **credentials
        `ca`, `cert`, `key` and `login`, files of the Zenoh session.

    Raises
    ------
    InputError
        The source, the file or the endpoint cannot be opened, or no depth image came.
    """
    place = None
    if listen is not None or connect is not None:
        place = _zenoh_place(listen, connect, credentials)
    own = with_colour_delay(sensor_of(source, sensor), colour_delay_s)
    obj = None if object is None else load_object(object)
    how: dict[str, Any] = {"solver": solver, "friction": friction, "zero_gas": zero_gas}
    with ExitStack() as stack:
        stop = stack.enter_context(_stopped_by_signals())
        stream = open_stream(source, own)
        recorder = _recorder(stack, stream, out, overwrite=overwrite)
        if shear:
            stream.follow_colour()
        publisher = None if place is None else stack.enter_context(ZenohPublisher(place))
        stack.enter_context(stream)
        watcher = Watcher.on(stream, source, own, obj=obj, stop=stop, shear=shear, **how)
        send = _Out(ResultMessages(watcher.pipeline.mesh, RESULTS), publisher, recorder)
        return _watch(watcher, send, stop, duration_s)


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


def _watch(
    watcher: Watcher, out: _Out, stop: threading.Event, duration_s: float | None
) -> WatchSummary:
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
            result = watcher.step(_LOOK_S)
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
            if time.monotonic() - told >= _DIAGNOSTICS_S:
                told = time.monotonic()
                status, counters = watcher.stream.status(), watcher.stream.counters()
                out.send(out.messages.diagnostics(time.time_ns(), status, counters, watcher.last))
                newest = (_force_text(watcher.last), *_shear_texts(watcher), status.text)
                bar.set_postfix_str(", ".join(filter(None, newest)))
    elapsed = time.monotonic() - began
    latency, texture = watcher.latency.report(), watcher.texture
    return WatchSummary(
        frames=statuses.total(),
        status=dict(statuses),
        rate_hz=statuses.total() / elapsed,
        max_force_n=max(forces, default=None),
        latency_median_s=None if latency is None else latency.median_s,
        latency_p95_s=None if latency is None else latency.p95_s,
        pressure_offset_pa=None if watcher.zero is None else watcher.zero.offset_pa,
        shear=None if shear is None or texture is None else shear.summary(texture.words),
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


def _shear_texts(watcher: Watcher) -> tuple[str, ...]:
    """Shear of the newest frame, and what it is measured against while that is not there."""
    if watcher.texture is None or watcher.last is None:
        return ()
    return (shear_line(watcher.last), watcher.texture.words)


def _recorder(
    stack: ExitStack, stream: LiveStream, out: str | Path | None, *, overwrite: bool
) -> Recorder | None:
    if out is None:
        return None
    stack.enter_context(_free(out, overwrite=overwrite))
    recorder = Recorder()
    recorder.start(out)

    def finish() -> None:
        status = recorder.stop()
        if status.problem:
            raise InputError(status.problem)

    stack.callback(finish)
    recorder.listen_to(stream)
    return recorder


@contextmanager
def _free(out: str | Path, *, overwrite: bool) -> Iterator[None]:
    """Room for a recording, which is written in place."""
    if overwrite:
        refuse_existing(out, overwrite=True)
    with set_aside(*([Path(out)] if overwrite else [])):
        yield


@dataclass(frozen=True)
class RecordSummary(Summary):
    """Summary of `record`.

    Attributes
    ----------
    source, out : str
    messages, frames : int
        Messages recorded, and depth images among them that make frames.
    duration_s : float
        From the first message to the end, s.
    size_bytes : int
    most_waiting_bytes, stalls : int
        How far the disk was behind at worst, and how often the source had to wait for it.
    counters : dict
        What was wrong with messages, see `Counters`; they are recorded all the same.
    """

    source: str
    out: str
    messages: int
    frames: int
    duration_s: float
    size_bytes: int
    most_waiting_bytes: int
    stalls: int
    counters: dict[str, Any]

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        lines = [
            f"wrote   {self.out}, {self.size_bytes / 1e6:.1f} MB",
            f"frames  {self.frames} in {self.duration_s:.2f} s, "
            f"{count_of(self.messages, 'message')}",
        ]
        wrong = {
            name.replace("_", " "): count
            for name, count in self.counters.items()
            if isinstance(count, int) and count and name not in ("received", "frames", "skipped")
        }
        if wrong:
            lines.append(f"notes   {counted(wrong)}; {self.counters['problem']}".rstrip("; "))
        return "\n".join(lines)


def record(
    source: str,
    out: str | Path,
    *,
    sensor: str | Path | Sensor = AUTO,
    duration_s: float | None = None,
    overwrite: bool = False,
) -> RecordSummary:
    """Record every message of a live source until the duration is over, it ends, or ^C.

    The file is whole then; should the machine stop, it opens up to the last second.

    Parameters
    ----------
    source : str
        As of `connect`.
    out : path
        `X.mcap`, or a rosbag2 folder.
    sensor : str, path or Sensor
        Simulated by `synthetic:`, where `auto` is the built-in one.
    duration_s : float, optional
        Counted from the first message, s.
    overwrite : bool
        Replace what exists.

    Raises
    ------
    InputError
        The source or the file cannot be opened, nothing arrived, or the disk refused.
    """
    stream = open_stream(source, _simulated(sensor), any_size=True)
    recorder = Recorder()
    recorder.listen_to(stream)
    first: float | None = None
    with _free(out, overwrite=overwrite):
        recorder.start(out)
        try:
            with _stopped_by_signals() as stop, stream:
                first = _wait(stream, recorder, stop, duration_s, patience_s(source))
        finally:
            status = recorder.stop()
        _check(status, stream, source)
    now, counters = time.monotonic(), stream.counters()
    return RecordSummary(
        source=source,
        out=str(status.path),
        messages=status.messages,
        frames=counters.frames,
        duration_s=now - (first or now),
        size_bytes=status.size_bytes,
        most_waiting_bytes=status.most_waiting_bytes,
        stalls=status.stalls,
        counters=counters.as_dict(),
    )


def _simulated(sensor: str | Path | Sensor) -> Sensor:
    return load_sensor(SYNTHETIC_SENSOR if str(sensor) == AUTO else sensor)


def _wait(
    stream: LiveStream,
    recorder: Recorder,
    stop: threading.Event,
    duration_s: float | None,
    patience: float,
) -> float | None:
    """Wait until recording ends; returns when the first message came (`time.monotonic`)."""
    began, first = time.monotonic(), None
    with tqdm(unit=" messages", disable=None, file=sys.stderr) as bar:  # only on a terminal
        while not stop.wait(_LOOK_S if first is None else 0.5 * _LOOK_S):
            status = recorder.status()
            if status is None or status.problem:
                return first
            stream.take()  # frees the slot of a frame that is not solved here
            bar.n = status.messages
            bar.set_postfix_str(f"{status.size_bytes / 1e6:.1f} MB, {stream.status().text}")
            now = time.monotonic()
            if first is None and stream.counters().received:
                first = now
            if stream.source.link() == "ended":
                return first
            if duration_s is None:
                continue
            if now - (first or now) >= duration_s:
                return first
            if first is None and now - began > patience:
                return None
    return first


def _check(status: RecorderStatus, stream: LiveStream, source: str) -> None:
    if status.problem:
        raise InputError(status.problem)
    problem, lost = stream.source.problem(), stream.source.link() == "lost"
    if problem and not (lost and status.messages):  # what came before it was lost is in the file
        raise InputError(f"--source {source}: {problem}")
    if not status.messages:
        there = offered(stream)
        raise InputError(f"--source {source}: nothing arrived ({there}); nothing was written")


@dataclass(frozen=True)
class PublishSummary(Summary):
    """Summary of `publish`.

    Attributes
    ----------
    source, endpoint : str
    sent : dict
        Messages by topic.
    """

    source: str
    endpoint: str
    sent: dict[str, int]

    def to_text(self) -> str:
        """A line for each topic."""
        return "\n".join(f"{count:>8}  {topic}" for topic, count in self.sent.items())


def publish(
    source: str,
    *,
    listen: str | None = None,
    connect: str | None = None,
    sensor: str | Path | Sensor = AUTO,
    layout: Layout = "rmw",
    domain: int = 0,
    duration_s: float | None = None,
    wait: bool = False,
    **credentials: str | None,
) -> PublishSummary:
    """Publish every message of a source over Zenoh until the duration is over, it ends, or ^C.

    Subscribers that are slow are waited for: nothing is lost on the way.

    Parameters
    ----------
    source, sensor, duration_s
        As of `record`.
    listen, connect : str, optional
        Endpoint that subscribers connect to, `tcp/127.0.0.1:7447` by default, or router to publish
        through.
    layout : {"rmw", "dds"}
        Names of keys.
    domain : int
        ROS_DOMAIN_ID.
    wait : bool
        Start once somebody subscribes.
    **credentials
        As of `watch`.

    Raises
    ------
    InputError
        The source cannot be opened, the address cannot be bound, or no router answers; or it is to
        wait, and its topics are not known before it starts.
    """
    place = _zenoh_place(listen, connect, credentials)
    sent: Counter[str] = Counter()
    live = open_stream(source, _simulated(sensor), any_size=True).source
    live.follow_colour()
    topics = live.topics()
    if wait and not topics:
        raise InputError(f"--source {source}: its topics come with its messages; leave --wait out")
    with (
        _stopped_by_signals() as stop,
        ZenohPublisher(place, layout=layout, domain=domain, wait=True) as publisher,
    ):

        def send(message: RawMessage) -> None:
            publisher.put(message.topic, message.type, message.payload, message.stamp_ns)
            sent[message.topic] += 1

        if wait:
            _wait_for_subscriber(publisher, topics, stop)
        live.start(send)
        try:
            began = None
            while not stop.wait(0.02) and live.link() != "ended":
                began = began or (time.monotonic() if sent else None)
                if duration_s and began and time.monotonic() - began >= duration_s:
                    break
        finally:
            live.stop()
        stop.wait(_LINGER_S)
    return PublishSummary(source, place.connect or place.listen or "", dict(sent))


def _wait_for_subscriber(
    publisher: ZenohPublisher, topics: tuple[OfferedTopic, ...], stop: threading.Event
) -> None:
    for topic in topics:
        publisher.announce(topic.name, topic.type)
    before = 0
    while not stop.is_set() and (not before or publisher.subscribed != before):
        before = publisher.subscribed
        stop.wait(_SETTLE_S)


def _zenoh_place(
    listen: str | None, connect: str | None, credentials: dict[str, str | None]
) -> SessionOptions:
    """Where to publish: at an endpoint, this computer's by default, or through a router."""
    if listen is not None and connect is not None:
        raise InputError("--listen and --connect: publish at a place or through a router, not both")
    if connect is None:
        listen = listen or ROUTER
    option = "--connect" if listen is None else "--listen"
    return SessionOptions(
        f"{option} {listen or connect}", connect, listen, Credentials(**credentials)
    )


@contextmanager
def _stopped_by_signals() -> Iterator[threading.Event]:
    """Event set by ^C and SIGTERM instead of their default action; main thread only."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    former = {
        number: signal.signal(number, lambda *_: stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
