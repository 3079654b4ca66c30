"""ROS 2 messages over Zenoh, without ROS."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import zenoh
from zenoh.ext import HistoryConfig, declare_advanced_subscriber
from zenoh.handlers import Callback

from bubbleviz.errors import InputError
from bubbleviz.live.live_source import Deliver, LiveSource, OfferedTopic
from bubbleviz.live.topic_names import TopicNames, is_used, stamp_of
from bubbleviz.live.zenoh_session import (
    TOKENS,
    Announced,
    Layout,
    NotConnectedError,
    SessionOptions,
    connected,
    is_topic,
    make_config,
    open_session,
    parse_token,
    subscription,
    type_of,
    unpack_attachment,
    why_no_session,
)
from bubbleviz.recordings import (
    COMPRESSED,
    COMPRESSED_IMAGE,
    IMAGE,
    Message,
    are_static_poses,
)

LAYOUTS: tuple[Layout, ...] = ("rmw", "dds")
POLL_S = 0.1  # interval of checks for newly announced topics and of the connection
MAX_ANNOUNCED = 4096  # publishers remembered, ten times a large robot's; chosen
DIAGNOSE_EVERY_S = 3.0
"""Interval of checks why a session does not return; Zenoh retries every 2 s at least."""


class ZenohSource(LiveSource):
    """Subscribes to every announced topic of a useful type, and to the topics named.

    Zenoh itself reconnects after a loss, with back-off; subscriptions remain valid, also for a
    publisher that returns.
    """

    closing_s = 2.0  # chosen: the thread may be waiting for a host that does not answer

    def __init__(
        self,
        options: SessionOptions,
        # topics chosen by name are subscribed to even if no publisher announces them
        names: TopicNames | None = None,
        domain: int = 0,  # ROS_DOMAIN_ID
    ) -> None:
        super().__init__(options.text)
        self._options, self._names, self._domain = options, names or TopicNames(), domain
        self._session: Any = None
        self._subscribers: dict[tuple[str, Layout], tuple[str, Any]] = {}  # with their type
        self._announced: dict[str, Announced] = {}
        self._tokens: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._counts: dict[tuple[bytes, str], int] = {}
        self._gate = threading.Lock()  # held while delivering, which may wait for a disk
        self._watchers: list[Any] = []
        self._callbacks = 0  # each runs in a thread of Zenoh's
        self._ended: queue.SimpleQueue[threading.Thread] = queue.SimpleQueue()
        self._deliver: Deliver | None = None

    def start(self, deliver: Deliver) -> None:
        self._deliver = deliver
        self._check_names()
        if self._options.listen is not None:
            self._session = open_session(self._options)
        else:
            make_config(self._options)  # a malformed endpoint is refused now
        super().start(deliver)

    def _check_names(self) -> None:
        """Raise InputError for a topic chosen by name that Zenoh would refuse."""
        for name in self._names.chosen:
            if not is_topic("/" + name.strip("/")):
                raise InputError(
                    f"{self.name}: {name!r} is not a topic name; give one such as /bubble/depth"
                )

    def stop(self) -> None:
        with self._gate:
            self._deliver = None
        super().stop()

    def follow_colour(self, on: bool = True) -> None:
        """Subscribe to colour topics, or unsubscribe, at the next poll."""
        self._names = replace(self._names, with_colour=on)

    def _named(self) -> list[tuple[str, str]]:
        """Topics chosen by name, with their types."""
        return [
            (topic, types[0] if len(types) == 1 else _image_type(topic))
            for topic, types in self._names.chosen.items()
            if topic != self._names.colour or self._names.with_colour
        ]

    def _on_token(self, sample: Any) -> None:
        self._tokens.put((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    def _run(self, deliver: Deliver) -> None:
        if not self._connect():
            return
        why, looked = "", time.monotonic()
        if self._options.connect is not None:  # a client's session is open once it is connected
            self.link = "up"
        try:
            self._subscribe_to_wanted()
            liveliness = self._session.liveliness()
            self._watchers = [
                liveliness.declare_subscriber(key, self._callback(self._on_token), history=True)
                for key in TOKENS
            ]
            while self._wait_until(time.monotonic() + POLL_S):
                while not self._tokens.empty():
                    self._take_token(*self._tokens.get())
                self._subscribe_to_wanted()
                self._unsubscribe_unwanted()
                if connected(self._session):
                    self.link, self.problem, looked = "up", "", time.monotonic()
                elif self.link != "connecting":
                    self.link = "lost"
                    if time.monotonic() - looked >= DIAGNOSE_EVERY_S:
                        why, looked = self._diagnose(why), time.monotonic()
        finally:
            self._session.close()
            self._join_callbacks()

    def _callback(self, function: Callable[[Any], None]) -> Callback[Any]:
        self._callbacks += 1
        return Callback(function, lambda: self._ended.put(threading.current_thread()))

    def _join_callbacks(self) -> None:
        """Wait for Zenoh's threads: one that ends while Python exits aborts the process."""
        deadline = time.monotonic() + self.closing_s
        for _ in range(self._callbacks):
            try:
                self._ended.get(timeout=max(deadline - time.monotonic(), 0.0)).join()
            except queue.Empty:
                return

    def _diagnose(self, before: str) -> str:
        """Determine why the session is lost; two checks must agree, as it may be returning."""
        place = self._options.connect
        why = "" if place is None else why_no_session(place, self._options.credentials)
        if why == before:
            self.problem = why
        return why

    def _connect(self) -> bool:
        """Open the session, retrying with increasing intervals; False when stopped."""
        while self._session is None:
            try:
                self._session = open_session(self._options)
                self.problem = ""
            except InputError as error:  # no router or peer yet, or wrong password
                self.problem = error.why if isinstance(error, NotConnectedError) else ""
                if not self._wait_to_retry():
                    return False
        return True

    def _take_token(self, key: str, alive: bool) -> None:
        announced = parse_token(key, self._domain)
        if announced is None:
            return
        if alive and len(self._announced) < MAX_ANNOUNCED:
            self._announced[key] = announced
        elif not alive:
            self._announced.pop(key, None)
        found = {(each.topic, each.type) for each in self._announced.values()}
        ours = [t for t in sorted(found) if is_used(*t) or self._names.is_colour(*t)]
        self.topics = tuple(OfferedTopic(*topic) for topic in ours)

    def _subscribe_to_wanted(self) -> None:
        """Subscribe to named and announced topics, except compressed images that also come raw.

        Robots announce them for every camera, and compress only for subscribers.
        """
        for topic, kind in self._named():
            for layout in LAYOUTS:
                self._subscribe(Announced(topic, kind, layout))
        there = {each.topic for each in self._announced.values()}
        for each in self._announced.values():
            named = each.topic in (self._names.depth, self._names.colour)
            spare = each.type == COMPRESSED_IMAGE and not named
            if spare and each.topic.rpartition("/")[0] in there:
                continue
            if self._names.wants(each.topic, each.type):
                self._subscribe(each)

    def _subscribe(self, announced: Announced) -> None:
        """Subscribe once per topic and key layout, however many publishers announce it."""
        place = (announced.topic, announced.layout)
        if place in self._subscribers:
            return
        key = subscription(announced.topic, announced.layout, self._domain)
        self._subscribers[place] = (announced.type, None)  # not retried if refused

        receive = self._callback(lambda sample: self._on_sample(sample, announced))
        try:
            if are_static_poses(announced.topic, announced.type):  # sent once, perhaps long ago
                history = HistoryConfig(detect_late_publishers=True)
                subscriber: Any = declare_advanced_subscriber(
                    self._session, key, receive, history=history
                )
            else:
                subscriber = self._session.declare_subscriber(key, receive)
        except zenoh.ZError:  # a name that Zenoh does not take is one of no sensor
            self._callbacks -= 1
            return
        self._subscribers[place] = (announced.type, subscriber)

    def _unsubscribe_unwanted(self) -> None:
        """Unsubscribe topics no longer needed; unsubscribed topics do not count as missing."""
        if self._names.with_colour:
            return
        for (topic, layout), (kind, subscriber) in list(self._subscribers.items()):
            if self._names.is_colour(topic, kind):
                del self._subscribers[topic, layout]
                if subscriber is not None:
                    subscriber.undeclare()
                with self._gate:
                    for heard in [k for k in self._counts if k[1] == topic]:
                        del self._counts[heard]

    def _on_sample(self, sample: Any, announced: Announced) -> None:
        arrival = time.time_ns()
        payload = sample.payload.to_bytes()
        kind = type_of(str(sample.key_expr)) if announced.layout == "rmw" else None
        attached = sample.attachment
        attachment = unpack_attachment(None if attached is None else attached.to_bytes())
        sequence = None if attachment is None else attachment.sequence
        message = Message(
            announced.topic,
            kind or announced.type,
            payload,
            stamp_of(payload),
            arrival,
            sequence,
        )
        with self._gate:
            if attachment is not None:
                self._count(attachment.publisher, announced.topic, attachment.sequence)
            deliver = self._deliver
            if deliver is not None:
                deliver(message)

    def _count(self, publisher: bytes, topic: str, sequence: int) -> None:
        """Count gaps in a publisher's sequence numbers."""
        last = self._counts.get((publisher, topic))
        if last is not None and sequence > last:
            self.missed += sequence - last - 1
        if last is None or sequence > last:
            self._counts[publisher, topic] = sequence
        if len(self._counts) > MAX_ANNOUNCED:
            del self._counts[next(iter(self._counts))]


def _image_type(topic: str) -> str:
    """Type of an image topic by its name, for those that are not announced."""
    return COMPRESSED_IMAGE if topic.endswith((f"/{COMPRESSED}", "/compressed")) else IMAGE
