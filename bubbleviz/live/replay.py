"""Live sources that replay a recording, or take frames from a plug-in or a simulation."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.live.live_source import Deliver, LiveSource, OfferedTopic
from bubbleviz.live.topic_names import TYPES, TopicNames, stamp_of
from bubbleviz.recordings import (
    GARBAGE_NS,
    Bag,
    Frame,
    FrameMessages,
    FrameSource,
    Message,
    Messages,
    are_static_poses,
    typestore,
)


class Replay(LiveSource):
    """Messages of a recording, delivered when they are due.

    Raises InputError: the recording cannot be read, or has none of the message types used here.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        speed: float = 1.0,  # relative to the recording
        loop: bool = False,  # restart at the end; else the source ends there
    ) -> None:
        self.path = Path(path)
        self._bag = Bag(path)
        super().__init__(self._bag.path.name)
        self._speed, self._loop = speed, loop
        self._streams: list[Messages] = [
            self._bag.messages(topic)
            for topic in self._bag.topics
            if topic.type in TYPES or are_static_poses(topic.name, topic.type)
        ]
        if not any(len(stream) for stream in self._streams if stream.topic.type in TYPES):
            self._bag.close()
            raise InputError(
                f"{path}: no images, point clouds, camera info, gas pressure or wrench; choose a "
                "recording of the sensor"
            )
        self.topics = tuple(OfferedTopic(s.topic.name, s.topic.type) for s in self._streams)
        self._playing = threading.Event()
        self._playing.set()

    def stop(self) -> None:
        self._playing.set()
        super().stop()
        self._bag.close()

    @contextmanager
    def held(self) -> Iterator[None]:
        self._playing.clear()
        try:
            yield
        finally:
            self._playing.set()

    def _run(self, deliver: Deliver) -> None:
        self.link = "up"
        rows = sorted(
            (int(log_ns), number, k)
            for number, stream in enumerate(self._streams)
            for k, log_ns in enumerate(stream.log_ns)
        )
        # pauses of more than an hour, as after a message logged in 1970, are skipped
        steps = np.diff([log_ns for log_ns, _, _ in rows], prepend=rows[0][0])
        after_s = 1e-9 * np.cumsum(np.where(steps > GARBAGE_NS, 0, steps)) / self._speed
        colour, played = TopicNames(), 0
        while True:
            start = time.monotonic()
            for after, (_, number, k) in zip(after_s.tolist(), rows, strict=True):
                if not self._wait_until(start + after):
                    return
                reached = time.monotonic()
                self._playing.wait()
                start += time.monotonic() - reached
                stream = self._streams[number]
                if self._with_colour or not colour.is_colour(stream.topic.name, stream.topic.type):
                    deliver(self._message(stream, k, played))
            if not self._loop:
                return
            played += 1

    def _message(self, stream: Messages, k: int, played: int) -> Message:
        payload = stream.payload(k)
        if self._bag.ros1:
            payload = _as_ros2(payload, stream.topic.type)
        return Message(
            stream.topic.name,
            stream.topic.type,
            payload,
            stamp_of(payload),
            time.time_ns(),
            round=played,
        )


def _as_ros2(payload: bytes, kind: str) -> bytes:
    """CDR of a ROS 1 message; invalid bytes are returned unchanged."""
    try:
        return bytes(typestore(ros1=True).ros1_to_cdr(payload, kind))
    except Exception:  # counted as undecodable by the reader
        return payload


# Frames as a live source: of a plug-in, or of a simulated sensor.


class FramesLive(LiveSource):
    """Streams frames as they come; those without a stamp get the time of their arrival."""

    closing_s: float | None = 2.0  # chosen: the thread may be waiting for the next frame

    def __init__(
        self,
        name: str,
        make: Callable[[], Iterator[Frame]],  # called, and waited for, in the source's own thread
        messages: FrameMessages,
    ) -> None:
        super().__init__(name)
        self._make, self._messages = make, messages

    def _run(self, deliver: Deliver) -> None:
        for sent, frame in enumerate(self._make()):
            if self._stopped.is_set():
                return
            messages = list(self._messages.of(frame, frame.stamp_ns or time.time_ns()))
            self.topics = tuple(OfferedTopic(m.topic, m.type) for m in messages)
            self.link = "up"
            for message in messages:
                deliver(message._replace(arrival_ns=time.time_ns(), sequence=sent))


_PREPARED = 0.5
"""Sending begins once the other frames are simulated in this share of the time until they are due,
at the usual pace so far: contact takes longer than rest, and solver and window run meanwhile."""


class SyntheticLive(FramesLive):
    """Streams the frames of a simulation in a loop, stamped with the current time."""

    closing_s = None

    def __init__(
        self,
        name: str,
        simulate: Callable[[], FrameSource],  # makes the simulation, in the source's thread
        rate_hz: float,  # frames a second
        *,
        # simulate as many frames before the first one is sent as make the first round smooth; else
        # frames may be late
        ahead: bool = True,
        messages: FrameMessages | None = None,  # how frames become messages
    ) -> None:
        super().__init__(name, self._frames, messages or FrameMessages())
        self._simulate, self._rate, self._ahead = simulate, rate_hz, ahead
        self.preparing = "simulating the first images"

    def _frames(self) -> Iterator[Frame]:
        """Frames when they are due, each simulated once, until the source is stopped."""
        simulation = self._simulate()
        pool = ThreadPoolExecutor(1, "simulation")
        try:
            count, done_s = len(simulation), [time.monotonic()]

            def simulated(k: int) -> Frame:
                frame = simulation[k]
                done_s.append(time.monotonic())  # here: who waits for it may be late
                return frame

            images = [pool.submit(simulated, k) for k in range(count)]
            for done, image in enumerate(images, 1):
                self.preparing = f"simulating the first images, {done} of {count}"
                image.result()
                left_s = float(np.median(np.diff(done_s[-100:]))) * (count - done)
                if not self._ahead or left_s < _PREPARED * count / self._rate:
                    break
                if self._stopped.is_set():
                    return
            start, epoch, sent = time.monotonic(), time.time_ns(), 0
            while self._wait_until(start + sent / self._rate):
                stamp_ns = epoch + round(sent / self._rate * 1e9)
                yield replace(images[sent % count].result(), stamp_ns=stamp_ns)
                sent += 1
        finally:
            pool.shutdown(cancel_futures=True)
            simulation.close()
