"""Publishing of results over Zenoh and into the recording; off by default."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from bubbleviz.live import ResultSender
from bubbleviz.pipeline import Product
from bubbleviz.recordings import Message, are_static_poses
from bubbleviz_ui.engine.worker import Failed, Worker
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.model.messages import Messages
from bubbleviz_ui.model.settings import LOOPBACK

if TYPE_CHECKING:
    from bubbleviz.live import ZenohPublisher


PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
"""Products that are published; the pose only while an object is tracked."""


class Publishing(QObject):
    """Publishes patch, force, pose and diagnostics of all connected sensors."""

    changed = Signal()  # Switched on or off

    def __init__(self, messages: Messages) -> None:
        super().__init__()
        self._messages = messages
        self.on = False
        self.endpoint = LOOPBACK  # Applied at the next start
        self._publisher: ZenohPublisher | None = None
        self._senders: list[ResultSender] = []
        self._unsubscribe: list[Callable[[], None]] = []
        self._lock = Lock()
        self._worker = Worker("publishing")

    def start(self, run: LiveRun) -> None:
        """Listen at the endpoint and publish all new results."""
        self.on, endpoint = True, self.endpoint
        then = partial(self._on_open, run)
        self._worker.submit(partial(_publisher, endpoint), then, self._on_refused)
        self.changed.emit()

    def stop(self) -> None:
        if not self.on:
            return
        self.on = False
        while self._unsubscribe:
            self._unsubscribe.pop()()
        self._senders.clear()
        with self._lock:
            publisher, self._publisher = self._publisher, None
        if publisher is not None:
            self._worker.submit(publisher.close)
        self.changed.emit()

    def diagnose(self) -> None:
        """Send the diagnostics that are due."""
        for sender in self._senders:
            sender.diagnose()

    def close(self) -> None:
        """Stop, and ask the thread to end."""
        self.stop()
        self._worker.close(0.0)

    def _on_refused(self, failed: Failed) -> None:
        self.stop()
        self._messages.add("error", f"Not publishing: {failed.message}", failed.details)

    def _on_open(self, run: LiveRun, publisher: ZenohPublisher) -> None:
        if not self.on:
            self._worker.submit(publisher.close)
            return
        with self._lock:
            self._publisher = publisher
        recorder, several = run.session.recorder, len(run.frames) > 1

        def send(message: Message) -> None:  # in any thread
            with self._lock:
                if self._publisher is not None:
                    self._publisher.put(message)
            if recorder.recording or are_static_poses(message.topic, message.type):
                recorder.push(message._replace(arrival_ns=time.time_ns()))

        def is_wanted(topic: str, kind: str) -> bool:
            with self._lock:
                opened = self._publisher
                subscribed = opened is not None and opened.is_subscribed(topic, kind)
            return subscribed or recorder.recording

        for frames, each in zip(run.frames, run.session.sensors, strict=True):
            name = each.place.name if several else ""
            sender = ResultSender(frames.stream, send, is_wanted, name)
            self._senders.append(sender)
            self._unsubscribe.append(frames.listen(sender))


def _publisher(endpoint: str) -> ZenohPublisher:
    # imports the network library: not at start
    from bubbleviz.live import SessionOptions, ZenohPublisher

    return ZenohPublisher(SessionOptions(f"publish at {endpoint}", None, endpoint))
