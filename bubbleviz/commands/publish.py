"""The work of `bubbleviz publish`: any source onto Zenoh, as a robot would."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from threading import Event

from bubbleviz.commands.stop_signals import stopped_by_signals
from bubbleviz.commands.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.live.sinks.zenoh_publisher import ZenohPublisher
from bubbleviz.live.sources.live_source import OfferedTopic
from bubbleviz.live.sources.open_stream import open_stream
from bubbleviz.live.sources.zenoh_keys import Layout
from bubbleviz.live.sources.zenoh_session import SessionOptions
from bubbleviz.sensor import Sensor

LINGER_S = 0.5
"""How long the session stays open after the last message, so that it goes out."""
SETTLE_S = 0.3
"""How long no more subscriptions must come before the first message: one subscriber has several."""


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


def publish_source(
    source: str,
    sensor: Sensor,
    place: SessionOptions,
    *,
    layout: Layout = "rmw",
    domain: int = 0,
    duration_s: float | None = None,
    wait: bool = False,
) -> PublishSummary:
    """Publish every message of a source until the duration is over, it ends, or ^C.

    Subscribers that are slow are waited for: nothing is lost on the way. With `wait` the source
    starts once somebody subscribes.

    Raises
    ------
    InputError
        The source cannot be opened, the address cannot be bound, or no router answers; or it is to
        wait, and its topics are not known before it starts.
    """
    sent: Counter[str] = Counter()
    live = open_stream(source, sensor, any_size=True).source
    live.follow_colour()
    topics = live.topics()
    if wait and not topics:
        raise InputError(f"--source {source}: its topics come with its messages; leave --wait out")
    with (
        stopped_by_signals() as stop,
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
        stop.wait(LINGER_S)
    return PublishSummary(source, place.connect or place.listen or "", dict(sent))


def _wait_for_subscriber(
    publisher: ZenohPublisher, topics: tuple[OfferedTopic, ...], stop: Event
) -> None:
    for topic in topics:
        publisher.announce(topic.name, topic.type)
    before = 0
    while not stop.is_set() and (not before or publisher.subscribed != before):
        before = publisher.subscribed
        stop.wait(SETTLE_S)
