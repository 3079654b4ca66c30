"""One live sensor: a source, the newest frame from its messages, and its listeners."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from bubbleviz.errors import InputError, StreamStoppedError
from bubbleviz.live.assembler import Counters, FrameAssembler
from bubbleviz.live.live_source import Link, LiveSource
from bubbleviz.recordings import NO_COLOUR, Frame, Message, check_gas_unit
from bubbleviz.sensor import Sensor, size_refusal

# State of a live source.


State = Literal["connecting", "live", "stale", "reconnecting", "ended"]

STALE_AFTER_S = 0.7  # a source without a depth image for this long is stale: shown within a second
STOPPED_AFTER_S = 1.0
"""A source without a depth image for this long has stopped, if the next one is waited for."""


@dataclass(frozen=True)
class Status:
    state: State  # `connecting`: nothing arrived yet. `stale`: connected, but no depth image comes.
    silent_s: float | None  # time since the last depth image, s; None before the first
    problem: str = ""  # why no image arrives, if known

    @property
    def text(self) -> str:
        if self.state == "connecting":
            return self.silence
        return f"{self.state}, {self.silence}" if self.silence else self.state

    @property
    def silence(self) -> str:
        """Text: how long no image has arrived; empty while images arrive."""
        if self.state == "connecting":
            return self.problem or "waiting for the first depth image"
        if self.state == "live" or self.silent_s is None:
            return ""
        return "; ".join(filter(None, (f"no image for {self.silent_s:.1f} s", self.problem)))


def status_of(link: Link, silent_s: float | None, problem: str = "") -> Status:
    """Status from the connection, the time since the last depth image, s, and a known problem."""
    if link == "ended":
        return Status("ended", silent_s)
    if link == "lost" and (silent_s is None or silent_s > STALE_AFTER_S):
        return Status("reconnecting", silent_s, problem)
    if silent_s is None:
        return Status("connecting", None, problem)
    if silent_s > STALE_AFTER_S:
        return Status("stale", silent_s, problem)
    return Status("live", silent_s)


POLL_S = 0.1
"""Interval of checks for the end of the source while waiting for a frame without a timeout."""
CAMERA_S = 0.5
"""How long the first frame may wait for camera info before the sensor file's is used."""
MIN_WRONG_SIZE = 5
"""Images of another size before they are reported: fewer may be damaged, or of another topic."""

_T = TypeVar("_T")
Listener = Callable[[Message], None]
Outage = tuple[int, int]  # arrival of the frames before and after, ns since 1970


class LiveStream:
    """Newest frames of a live source; a frame that is not taken in time is skipped.

    A context manager; iterating yields frames until the source ends. It raises `InputError` if the
    first frame does not come within 10 s, and `StreamStoppedError` if a later one does not come
    within `timeout_s`; both say what is missing.

    Parameters
    ----------
    source : LiveSource
        Not started: the stream starts and stops it.
    sensor : Sensor
        Sensor of the frames.
    assembler : FrameAssembler, optional
    uri : str
        URI of the source, for messages.
    patience_s : float
        How long the first frame may take, s.
    timeout_s : float, optional
        Longest wait for a later frame while iterating, s; None: no limit, also for the first.
    """

    def __init__(
        self,
        source: LiveSource,
        sensor: Sensor,
        assembler: FrameAssembler | None = None,
        *,
        uri: str = "",
        patience_s: float = math.inf,
        timeout_s: float | None = STOPPED_AFTER_S,
    ) -> None:
        self.name = source.name
        self.source, self.sensor, self.uri = source, sensor, uri or source.name
        self.patience_s, self.timeout_s = patience_s, timeout_s
        self._started = False
        self._assembler = assembler or FrameAssembler()
        self._newest: Frame | None = None  # not taken yet; a newer one replaces it
        self._skipped = 0  # frames that were replaced
        self._stopped = False
        self._changed = threading.Condition()  # of these three
        self._lock = threading.Lock()  # held while images are decoded
        self._listeners: tuple[Listener, ...] = ()
        self._colour_followers: set[object] = set()
        self._last_frame_ns: int | None = None
        self.outages: tuple[Outage, ...] = ()  # past periods in which it was stale
        self._wrong_before = 0

    def __enter__(self) -> LiveStream:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        if self._last_frame_ns is None and not self.ended:
            yield self.first_frame(math.inf if self.timeout_s is None else None, camera_s=0.0)
        yield from self.each(self.take, self.timeout_s)

    def start(self) -> None:
        """Start the source, once; InputError when that is impossible."""
        if not self._started:
            self._started = True
            self.source.start(self._deliver)

    def close(self) -> None:
        """Stop the source and wake threads that wait for a frame."""
        self.source.stop()
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call a listener with every message, in the source's threads; returns how to undo it.

        A listener must be quick and must not raise.
        """
        with self._lock:
            self._listeners = (*self._listeners, listener)

        def undo() -> None:
            with self._lock:
                self._listeners = tuple(k for k in self._listeners if k is not listener)

        return undo

    def follow_colour(self) -> Callable[[], None]:
        """Subscribe to colour images, which the source sends only then; returns how to unsubscribe.

        They are sent until the last subscriber has unsubscribed.
        """
        follower = object()
        with self._lock:
            self._colour_followers.add(follower)
            self._follow_colour()

        def undo() -> None:
            with self._lock:
                self._colour_followers.discard(follower)
                self._follow_colour()

        return undo

    def _follow_colour(self) -> None:
        on = bool(self._colour_followers)
        self._assembler.follow_colour(on)
        self.source.follow_colour(on)

    @property
    def ended(self) -> bool:
        """Whether the source has no more frames."""
        return self.source.link == "ended"

    def first_frame(
        self,
        patience_s: float | None = None,
        waiting: Callable[[], object] = lambda: None,
        camera_s: float = CAMERA_S,
    ) -> Frame:
        """Wait for the first frame, and up to `camera_s` longer for one with camera info.

        Parameters
        ----------
        patience_s : float, optional
            Timeout, s; default: the stream's.
        waiting : callable
            Called regularly while waiting; an exception in it ends the wait.
        camera_s : float

        Raises
        ------
        InputError
            No frame came, only images that are not of the sensor's camera, or a gas pressure in
            another unit.
        """
        patience_s = self.patience_s if patience_s is None else patience_s
        began, camera_by, frame = time.monotonic(), math.inf, None
        while True:
            frame = self.take_after(frame, POLL_S)
            now, ended = time.monotonic(), self.ended
            if frame is not None:
                camera_by = min(camera_by, now + camera_s)
                if frame.intrinsics is not None or ended or now >= camera_by:
                    if frame.gas_pressure_pa is not None:
                        check_gas_unit(frame.gas_pressure_pa, self.sensor, self.uri)
                    return frame
            else:
                if error := self._size_refusal(1 if ended else MIN_WRONG_SIZE):
                    raise error
                if ended or now - began > patience_s:
                    raise self.nothing_arrived()
            waiting()

    def take(self, timeout_s: float = 0.0) -> Frame | None:
        """Newest frame not yet taken; waits for one, None on timeout."""
        deadline = time.monotonic() + timeout_s
        while True:
            frame = self._take(min(max(deadline - time.monotonic(), 0.0), self._patience_s()))
            ended = self.ended
            if frame is None:
                with self._lock:  # at the end no more messages can complete it
                    self._put(self._assembler.flush(None if ended else time.time_ns()))
                frame = self._take(0.0)
            if frame is not None:
                return frame
            if ended or time.monotonic() >= deadline:
                return None

    def take_after(self, held: Frame | None, timeout_s: float = 0.0) -> Frame | None:
        """As `take`, or else `held`, a frame taken before but not used; a newer one skips it."""
        frame = self.take(timeout_s)
        if frame is None or held is None:
            return frame or held
        with self._changed:
            self._skipped += 1
        return frame

    def _take(self, timeout_s: float) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._stopped, timeout_s)
            frame, self._newest = self._newest, None
            return frame

    def status(self) -> Status:
        problem = self._problem()
        if problem:  # of several sources, which
            problem = f"{problem} ({self.name})"
        return status_of(self.source.link, self._silent_s(), problem)

    def _silent_s(self) -> float | None:
        """Time since the last frame arrived, s; None before the first."""
        last = self._last_frame_ns
        return None if last is None else max(time.time_ns() - last, 0) * 1e-9

    def each(
        self,
        # waits up to a timeout, s, for a frame and processes it; None on timeout
        take: Callable[[float], _T | None],
        # longest time since the last frame arrived, s; None waits forever
        timeout_s: float | None = STOPPED_AFTER_S,
    ) -> Iterator[_T]:
        """Results of `take` for the newest frames, until the source ends.

        Raises StreamStoppedError: no frame came in that time.
        """
        while True:
            ended = self.ended  # first: a frame may come before the end is seen
            silent_s = self._silent_s() or 0.0
            made = take(POLL_S if timeout_s is None else max(timeout_s - silent_s, 0.0))
            if made is not None:
                yield made
            elif ended:
                return
            elif timeout_s is not None and (self._silent_s() or 0.0) >= timeout_s:
                longer = "" if self._problem() else ", or give a longer timeout_s"
                raise StreamStoppedError(f"{self.silence()}{longer}")

    def nothing_arrived(self) -> InputError:
        """The error to raise about a source without a depth image, with the reason if known."""
        reason = self.source.problem  # with its remedy
        if not reason and self.counters.problem:
            reason = (
                f"the last problem was {self.counters.problem}; correct its publisher, or choose a "
                "topic by ?depth="
            )
        elif not reason and self.source.topics:
            reason = (
                f"{self.offered}; check that depth images are among them and the camera publishes, "
                "or choose a topic by ?depth="
            )
        reason = reason or f"{self.offered}; check that the camera publishes, and address or file"
        return InputError(f"{self.uri}: no depth image arrived: {reason}")

    @property
    def offered(self) -> str:
        """Text: topics that the source has."""
        topics = ", ".join(topic.name for topic in self.source.topics)
        return f"topics found: {topics}" if topics else "no topics were found"

    def silence(self) -> str:
        """Text: for how long no depth image has come, and why, or what to check."""
        silent_s = self.status().silent_s
        since = "" if silent_s is None else f" for {silent_s:.1f} s"
        remedy = self._problem() or "check the camera and its connection"
        return f"{self.name}: no depth image{since}; {remedy}"

    def _problem(self) -> str:
        """Why no depth image comes, if known."""
        return self.source.problem or str(self._size_refusal() or "")

    @property
    def frozen(self) -> str:
        """Warning about a camera that repeats one image; else empty."""
        return self._assembler.equal.warning

    @property
    def depth_frame(self) -> str:
        """Frame of reference that the depth images name; empty before the first."""
        return self._assembler.depth_frame

    @property
    def counters(self) -> Counters:
        """Counts of received, skipped and faulty messages so far."""
        # no lock: the window must not wait for an image to be decoded
        return replace(self._assembler.counters, skipped=self._skipped, missed=self.source.missed)

    def _size_refusal(self, enough: int = MIN_WRONG_SIZE) -> InputError | None:
        """The error about images of another size since the last frame; None for fewer."""
        size, own = self._assembler.other_size, self._assembler.size
        wrong = self._assembler.counters.wrong_size - self._wrong_before
        if wrong < enough or size is None or own is None:
            return None
        named = self.sensor.file or self.sensor.name
        return size_refusal(f"{self.uri}: images are", size, named, own)

    def _patience_s(self) -> float:
        """Time until the pending frame must be checked again, s."""
        until = self._assembler.waits_until_ns
        return 0.1 if until is None else min(max((until - time.time_ns()) * 1e-9, 0.001), 0.1)

    def _deliver(self, message: Message) -> None:
        for listener in self._listeners:  # unlocked: a recorder may wait for its disk
            listener(message)
        with self._lock:
            self._put(self._assembler.push(message))

    def _no_colour(self) -> str:
        """Why frames have no colour images."""
        topic = self._assembler.colour_topic(self.source.topics)
        if not topic:
            return NO_COLOUR
        if not self._colour_followers:
            return "colour images were not yet subscribed to when this frame arrived"
        return f"waiting for colour images on {topic}"

    def _put(self, frames: list[Frame]) -> None:
        for frame in frames:
            if frame.find_colour is None:
                frame = replace(frame, no_colour=self._no_colour())
            self._wrong_before = self._assembler.counters.wrong_size
            before, self._last_frame_ns = self._last_frame_ns, frame.arrival_ns
            if before is not None and frame.arrival_ns - before > 1e9 * STALE_AFTER_S:
                self.outages = (*self.outages, (before, frame.arrival_ns))
            with self._changed:
                self._skipped += self._newest is not None
                self._newest = frame
                self._changed.notify_all()


# Latency: the age of a frame when it is displayed.


class LatencyReport(NamedTuple):
    """Ages of the last frames, s."""

    median_s: float
    p95_s: float


class LatencyMeter:
    """Ages of the last `window` frames at one point of the processing."""

    def __init__(self, window: int = 600) -> None:
        self._ages: deque[float] = deque(maxlen=window)

    def add(self, frame: Frame, now_ns: int) -> None:
        """Add the age of a live frame."""
        self._ages.append((now_ns - (frame.taken_ns or now_ns)) * 1e-9)

    def report(self) -> LatencyReport | None:
        """Ages so far; None before the first frame."""
        if not self._ages:
            return None
        median, p95 = np.percentile(np.array(self._ages), [50.0, 95.0])
        return LatencyReport(float(median), float(p95))
