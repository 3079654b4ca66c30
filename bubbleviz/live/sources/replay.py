"""A recording played as if it were live: its own messages, at the pace they were recorded."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from bubbleviz.colour.static_poses import are_static_poses
from bubbleviz.errors import InputError
from bubbleviz.frames.bags import Bag, Messages
from bubbleviz.frames.bags.bag import typestore
from bubbleviz.live.raw_message import RawMessage, stamp_of
from bubbleviz.live.sources.live_source import Deliver, LiveSource, OfferedTopic
from bubbleviz.live.topic_names import TYPES, TopicNames


class Replay(LiveSource):
    """Messages of a recording, delivered when they are due.

    Parameters
    ----------
    path : path-like
    speed : float
        Times faster than recorded.
    loop : bool
        Begin again at the end; else the source ends there.
    realtime : bool
        False delivers everything at once, as fast as it is read.

    Raises
    ------
    InputError
        The recording cannot be read, or has none of the message types used here.
    """

    def __init__(
        self, path: str | Path, *, speed: float = 1.0, loop: bool = False, realtime: bool = True
    ) -> None:
        self._bag = Bag(path)
        super().__init__(self._bag.path.name)
        self._speed, self._loop, self._realtime = speed, loop, realtime
        self._streams: list[Messages] = [
            self._bag.messages(topic)
            for topic in self._bag.topics
            if topic.type in TYPES or are_static_poses(topic.name, topic.type)
        ]
        if not any(len(stream) for stream in self._streams if stream.topic.type in TYPES):
            self._bag.close()
            raise InputError(f"{path}: has none of the messages used here; see bubbleviz info")
        self._offered = tuple(OfferedTopic(s.topic.name, s.topic.type) for s in self._streams)

    def stop(self) -> None:
        """Stop playing and close the recording."""
        super().stop()
        self._bag.close()

    def _run(self, deliver: Deliver) -> None:
        self._link = "up"
        times = np.concatenate([stream.log_ns for stream in self._streams])
        which = np.repeat(np.arange(len(self._streams)), [len(s) for s in self._streams])
        number = np.concatenate([np.arange(len(s)) for s in self._streams])
        order = np.argsort(times, kind="stable")
        rows = [(int(which[k]), int(number[k]), int(times[k])) for k in order]
        colour, played = TopicNames(), 0
        while True:
            start = time.monotonic()
            for stream, k, log_ns in rows:
                due = start + (log_ns - rows[0][2]) * 1e-9 / self._speed
                if not self._wait_until(due if self._realtime else start):
                    return
                topic = self._streams[stream].topic
                if self._with_colour or not colour.is_colour(topic.name, topic.type):
                    deliver(self._message(self._streams[stream], k, played))
            if not self._loop:
                return
            played += 1

    def _message(self, stream: Messages, k: int, played: int) -> RawMessage:
        payload = stream.payload(k)
        if self._bag.ros1:
            payload = _as_ros2(payload, stream.topic.type)
        return RawMessage(
            stream.topic.name,
            stream.topic.type,
            payload,
            stamp_of(payload),
            time.time_ns(),
            round=played,
        )


def _as_ros2(payload: bytes, kind: str) -> bytes:
    """CDR of a ROS 1 message; the same bytes where they are no such message."""
    try:
        return bytes(typestore(ros1=True).ros1_to_cdr(payload, kind))
    except Exception:  # counted as undecodable by whoever reads it
        return payload
