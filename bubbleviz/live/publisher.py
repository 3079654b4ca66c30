"""Publish ROS 2 messages over Zenoh, for ROS 2 nodes and the window."""

from __future__ import annotations

import secrets
import time
from typing import Any

import zenoh
from zenoh.ext import CacheConfig, MissDetectionConfig, declare_advanced_publisher

from bubbleviz.live.zenoh_session import (
    Attachment,
    SessionOptions,
    announcement,
    open_session,
    pack_attachment,
    publication,
)
from bubbleviz.recordings import Message, are_static_poses, ros2_types

_STATIC_CACHE = 100  # messages of a topic; chosen: robots have a few
_NUMBERED = MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""Numbers the cached messages; otherwise Zenoh requires time stamps on all messages."""


class ZenohPublisher:
    """Publishes serialised messages as `rmw_zenoh` does; announces topics with their first one."""

    def __init__(
        self,
        options: SessionOptions,  # where to listen, or the router to publish through
        *,
        domain: int = 0,  # ROS_DOMAIN_ID
        # wait for slow subscribers, so that no message is lost; else drop messages
        wait: bool = False,
    ) -> None:
        self._session = open_session(options)
        self.endpoint = options.connect or options.listen or ""
        self._domain, self._wait = domain, wait
        self._publishers: dict[tuple[str, str], Any] = {}
        self._tokens: list[Any] = []
        self._sent: dict[tuple[str, str], int] = {}
        self._identity = secrets.token_bytes(16)

    def __enter__(self) -> ZenohPublisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def announce(self, topic: str, kind: str) -> None:
        if (topic, kind) in self._publishers:
            return
        type_hash = ros2_types().hash_rihs01(kind)
        control = zenoh.CongestionControl.BLOCK if self._wait else zenoh.CongestionControl.DROP
        key = publication(topic, kind, type_hash, self._domain)
        if are_static_poses(topic, kind):  # later subscribers receive them too
            self._publishers[topic, kind] = declare_advanced_publisher(
                self._session,
                key,
                congestion_control=control,
                cache=CacheConfig(_STATIC_CACHE),
                sample_miss_detection=_NUMBERED,
                publisher_detection=True,
            )
        else:
            self._publishers[topic, kind] = self._session.declare_publisher(
                key, congestion_control=control
            )
        number = len(self._publishers)
        session = str(self._session.zid())
        token = announcement(topic, kind, type_hash, self._domain, session, number)
        self._tokens.append(self._session.liveliness().declare_token(token))

    def put(self, message: Message) -> None:
        topic, kind = message.topic, message.type
        self.announce(topic, kind)
        sequence = self._sent.get((topic, kind), 0) + 1
        self._sent[topic, kind] = sequence
        stamp = message.stamp_ns or time.time_ns()
        attachment = pack_attachment(Attachment(sequence, stamp, self._identity))
        self._publishers[topic, kind].put(message.payload, attachment=attachment)

    def is_subscribed(self, topic: str, kind: str) -> bool:
        """Whether a topic has a subscriber; announces it, so that it can get one."""
        self.announce(topic, kind)
        return bool(self._publishers[topic, kind].matching_status.matching)

    @property
    def subscribed(self) -> int:
        """Number of announced topics that have a subscriber."""
        return sum(
            each.matching_status.matching
            for place, each in self._publishers.items()
            if not are_static_poses(*place)
        )

    def close(self) -> None:
        self._session.close()
