"""Recording and publishing of live sources, until they end or ^C."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from bubbleviz.api.summary import Summary
from bubbleviz.errors import InputError, check_given, check_number
from bubbleviz.files import SYNTHETIC_SENSOR, refuse_existing, refuse_input, restore_on_error
from bubbleviz.live import LiveStream, Recorder, RecorderStatus, open_stream
from bubbleviz.recordings import AUTO, Message
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.wording import count_of, counted

if TYPE_CHECKING:
    from bubbleviz.live import LiveSource, OfferedTopic, ZenohPublisher

_POLL_S = 0.05  # polling period of a source; chosen
_CLOSING_DELAY_S = 0.5
"""Time until the session is closed after the last message, so that it is sent."""
_SUBSCRIPTION_DELAY_S = 0.3
"""Time without new subscriptions before the first message, as a subscriber has several."""


@dataclass(frozen=True)
class RecordSummary(Summary):
    """Summary of `record`."""

    source: str
    out: str
    messages: int
    frames: int  # complete frames among the messages
    duration_s: float  # from the first message to the end
    size_bytes: int
    counters: dict[str, Any]  # of problems with messages, which are recorded nevertheless

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        lines = [
            f"wrote   {self.out}, {self.size_bytes / 1e6:.1f} MB",
            f"frames  {self.frames} in {self.duration_s:.2f} s, "
            f"{count_of(self.messages, 'message')}",
        ]
        problems = {
            name.replace("_", " "): count
            for name, count in self.counters.items()
            if isinstance(count, int) and count and name not in ("received", "frames", "skipped")
        }
        if problems:
            last = self.counters["problem"]
            lines.append(f"notes   {counted(problems)}" + (f"; the last: {last}" if last else ""))
        return "\n".join(lines)


def record(
    source: str,
    out: str | Path,
    *,
    sensor: str | Path | Sensor = AUTO,
    duration_s: float | None = None,
    overwrite: bool = False,
) -> RecordSummary:
    """Record every message of a live source.

    Runs until the duration is over, the source ends, or ^C. After a crash of the machine the file
    can be opened up to the last second.

    Parameters
    ----------
    source : str
        As in `connect`.
    out : path
        Recording: REC.mcap, or a folder (rosbag2).
    sensor : str, path or Sensor
        Sensor to simulate, only for `synthetic:`; `auto`: the built-in one.
    duration_s : float, optional
        Duration from the first message on, s; by default until ^C or the end of the source.
    overwrite : bool
        Replace existing files.

    Raises
    ------
    InputError
        The source or the file cannot be opened, nothing arrived, or writing failed.
    """
    check_given("--duration", duration_s, 1e-3)
    stream = open_stream(source, _simulated(sensor), any_size=True)
    recorder = Recorder()
    recorder.listen_to(stream)
    first, lost = None, False
    with (
        replacing(out, stream.source, overwrite=overwrite) as replaces,
        stopped_by_signals() as stop,
    ):
        recorder.start(out, replaces=replaces)
        try:
            with stream:
                first = _wait(stream, recorder, stop, duration_s)
                lost = stream.source.link == "lost"
        finally:
            status = recorder.stop()
        _check(status, stream, source, lost=lost)
    now, counters = time.monotonic(), stream.counters
    return RecordSummary(
        source=source,
        out=str(status.path),
        messages=status.messages,
        frames=counters.frames,
        duration_s=now - (first or now),
        size_bytes=status.size_bytes,
        counters=asdict(counters),
    )


def _simulated(sensor: str | Path | Sensor) -> Sensor:
    return load_sensor(SYNTHETIC_SENSOR if str(sensor) == AUTO else sensor)


def _wait(
    stream: LiveStream,
    recorder: Recorder,
    stop: threading.Event,
    duration_s: float | None,
) -> float | None:
    """Wait until recording ends; returns the time of the first message (`time.monotonic`)."""
    began, first = time.monotonic(), None
    with tqdm(unit=" messages", disable=None, file=sys.stderr) as bar:  # only on a terminal
        for first in _poll(stop, duration_s, lambda: stream.counters.received > 0):
            status = recorder.status()
            if status is None or status.problem or stream.ended:
                break
            stream.take()  # frees the slot of the newest frame, which is not solved
            bar.n = status.messages
            bar.set_postfix_str(f"{status.size_bytes / 1e6:.1f} MB, {stream.status().text}")
            waited_s = time.monotonic() - began
            if first is None and duration_s is not None and waited_s > stream.patience_s:
                break
    return first


def _poll(
    stop: threading.Event, duration_s: float | None, has_begun: Callable[[], bool]
) -> Iterator[float | None]:
    """Yield at every poll the time of the first message (`time.monotonic`), or None before.

    Ends by `stop`, or `duration_s` after the first message.
    """
    first: float | None = None
    while not stop.wait(_POLL_S):
        first = first or (time.monotonic() if has_begun() else None)
        yield first
        if duration_s is not None and first and time.monotonic() - first >= duration_s:
            return


def _check(status: RecorderStatus, stream: LiveStream, source: str, *, lost: bool) -> None:
    if status.problem:
        raise InputError(status.problem)
    problem = stream.source.problem
    if problem and not (lost and status.messages):  # messages before the loss are in the file
        raise InputError(f"{source}: {problem}")
    if not status.messages:
        offered = stream.offered
        raise InputError(
            f"{source}: no message arrived ({offered}), so nothing was written; check "
            "address or file, and that the sensor publishes"
        )


@dataclass(frozen=True)
class PublishSummary(Summary):
    """Summary of `publish`."""

    source: str
    endpoint: str
    sent: dict[str, int]  # messages by topic

    def to_text(self) -> str:
        """A line for each topic."""
        return "\n".join(f"{count:>8}  {topic}" for topic, count in self.sent.items())


def publish(
    source: str,
    *,
    listen: str | None = None,
    connect: str | None = None,
    sensor: str | Path | Sensor = AUTO,
    domain: int = 0,
    duration_s: float | None = None,
    wait: bool = False,
    **credentials: str | None,
) -> PublishSummary:
    """Publish a source over Zenoh, as ROS 2 nodes would.

    Publishes every message until the duration is over, the source ends, or ^C. Slow subscribers
    delay the source; no message is lost.

    Parameters
    ----------
    source, sensor, duration_s
        As in `record`.
    listen : str, optional
        Endpoint for subscribers that connect; tcp/127.0.0.1:7447 by default.
    connect : str, optional
        Router to publish through, such as tcp/HOST:7447.
    domain : int
        ROS_DOMAIN_ID, 0 to 232.
    wait : bool
        Start when a subscriber connects.
    **credentials
        As in `watch`.

    Raises
    ------
    InputError
        The source cannot be opened, the address cannot be bound, no router answers, or there is no
        such domain; or `wait` is given and the topics of the source are unknown before it starts.
    """
    check_given("--duration", duration_s, 1e-3)
    check_number("--domain", domain, 0, 232, whole=True)
    sent: Counter[str] = Counter()
    live = open_stream(source, _simulated(sensor), any_size=True).source
    live.follow_colour()
    topics = live.topics
    if wait and not topics:
        raise InputError(
            f"{source}: this source cannot list its topics before the first message; "
            "leave out --wait"
        )
    with (
        stopped_by_signals() as stop,
        zenoh_publisher(listen, connect, credentials, domain=domain, wait=True) as publisher,
    ):

        def send(message: Message) -> None:
            publisher.put(message)
            sent[message.topic] += 1

        if wait:
            _wait_for_subscriber(publisher, topics, stop)
        live.start(send)
        try:
            for _ in _poll(stop, duration_s, lambda: bool(sent)):
                if live.link == "ended":
                    break
        finally:
            live.stop()
        stop.wait(_CLOSING_DELAY_S)
    return PublishSummary(source, publisher.endpoint, dict(sent))


def _wait_for_subscriber(
    publisher: ZenohPublisher, topics: tuple[OfferedTopic, ...], stop: threading.Event
) -> None:
    for topic in topics:
        publisher.announce(topic.name, topic.type)
    before = 0
    while not stop.is_set() and (not before or publisher.subscribed != before):
        before = publisher.subscribed
        stop.wait(_SUBSCRIPTION_DELAY_S)


def zenoh_publisher(
    listen: str | None,
    connect: str | None,
    credentials: dict[str, str | None],
    *,
    domain: int = 0,
    wait: bool = False,
) -> ZenohPublisher:
    """Publisher at an endpoint, by default of this computer, or by a router; warns if it is open.

    Raises InputError: both are given, or there is no session.
    """
    from bubbleviz.live import (
        ROUTER,
        Credentials,  # not needed by `record`
        SessionOptions,
        ZenohPublisher,
        listening_warning,
    )

    if listen is not None and connect is not None:
        raise InputError(
            "give either --listen (subscribers connect here) or --connect (a router), not both"
        )
    if connect is None:
        listen = listen or ROUTER
    option = "--connect" if listen is None else "--listen"
    place = SessionOptions(
        f"{option} {listen or connect}", connect, listen, Credentials(**credentials)
    )
    publisher = ZenohPublisher(place, domain=domain, wait=wait)
    if warning := listening_warning(place):
        tqdm.write(f"bubbleviz: warning: {warning}", file=sys.stderr)
    return publisher


@contextmanager
def replacing(out: str | Path, source: LiveSource, *, overwrite: bool) -> Iterator[bool]:
    """Move an existing recording aside while its replacement is written; whether there is one.

    Raises InputError: it cannot be replaced, or the source reads it.
    """
    if overwrite:
        refuse_input(out, getattr(source, "path", None))
        refuse_existing(out, ".mcap", "", overwrite=True)
    replaces = overwrite and Path(out).exists()
    with restore_on_error(*([Path(out)] if overwrite else [])):
        yield replaces


@contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
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
