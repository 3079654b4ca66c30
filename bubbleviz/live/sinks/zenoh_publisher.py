"""ROS 2 messages out over Zenoh, as ROS 2 nodes and the window expect them."""

from __future__ import annotations

import secrets
import time
from typing import Any

import zenoh
from zenoh.ext import CacheConfig, MissDetectionConfig, declare_advanced_publisher

from bubbleviz.colour.static_poses import are_static_poses
from bubbleviz.frames.message_encoding import ros2_types
from bubbleviz.live.sources.zenoh_keys import (
    Attachment,
    Layout,
    announcement,
    pack_attachment,
    publication,
)
from bubbleviz.live.sources.zenoh_session import SessionOptions, connected, open_session

_STATIC_KEPT = 100  # messages of a topic; chosen: robots have a few
_COUNTED = MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""Of what is kept for later subscribers; without, Zenoh would have to stamp all messages."""


class ZenohPublisher:
    """Publishes serialised messages, each topic announced with its first one.

    Parameters
    ----------
    options : SessionOptions
        Where to listen, or the router to publish through.
    layout : {"rmw", "dds"}
        As `rmw_zenoh` publishes, or as the ROS 2 DDS bridge does.
    domain : int
        ROS_DOMAIN_ID.
    wait : bool
        Wait for a subscriber that is too slow, so that nothing is lost; else leave it behind.
    """

    def __init__(
        self,
        options: SessionOptions,
        *,
        layout: Layout = "rmw",
        domain: int = 0,
        wait: bool = False,
    ) -> None:
        self._session = open_session(options)
        self._layout, self._domain, self._wait = layout, domain, wait
        self._publishers: dict[tuple[str, str], Any] = {}
        self._tokens: list[Any] = []
        self._sent: dict[tuple[str, str], int] = {}
        self._identity = secrets.token_bytes(16)

    def __enter__(self) -> ZenohPublisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def announce(self, topic: str, kind: str) -> None:
        """Announce a topic before its first message."""
        if (topic, kind) in self._publishers:
            return
        type_hash = ros2_types().hash_rihs01(kind)
        control = zenoh.CongestionControl.BLOCK if self._wait else zenoh.CongestionControl.DROP
        key = publication(topic, kind, type_hash, self._layout, self._domain)
        if are_static_poses(topic, kind):  # who subscribes later gets them, too
            self._publishers[topic, kind] = declare_advanced_publisher(
                self._session,
                key,
                congestion_control=control,
                cache=CacheConfig(_STATIC_KEPT),
                sample_miss_detection=_COUNTED,
                publisher_detection=True,
            )
        else:
            self._publishers[topic, kind] = self._session.declare_publisher(
                key, congestion_control=control
            )
        number = len(self._publishers)
        session = str(self._session.zid())
        token = announcement(topic, kind, type_hash, self._layout, self._domain, session, number)
        self._tokens.append(self._session.liveliness().declare_token(token))

    def put(self, topic: str, kind: str, payload: bytes, stamp_ns: int = 0) -> None:
        """Publish a message."""
        self.announce(topic, kind)
        sequence = self._sent.get((topic, kind), 0) + 1
        self._sent[topic, kind] = sequence
        stamp = stamp_ns or time.time_ns()
        attachment = pack_attachment(Attachment(sequence, stamp, self._identity))
        self._publishers[topic, kind].put(payload, attachment=attachment)

    @property
    def subscribed(self) -> int:
        """To how many of the announced topics somebody subscribes."""
        return sum(
            each.matching_status.matching
            for place, each in self._publishers.items()
            if not are_static_poses(*place)
        )

    @property
    def connected(self) -> bool:
        """Whether anybody is there."""
        return connected(self._session)

    def close(self) -> None:
        """Close the session."""
        self._session.close()
