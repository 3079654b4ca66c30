"""Results out of the window: over Zenoh, and into the recording. Off until asked for."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Lock
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal

from bubbleviz.frames.message_encoding import Message
from bubbleviz.live.raw_message import RawMessage
from bubbleviz_ui.engine.jobs import Done, Jobs
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.live.result_sender import ResultSender
from bubbleviz_ui.model.choices import LOOPBACK
from bubbleviz_ui.model.messages import UserMessage

if TYPE_CHECKING:
    from bubbleviz.live.sinks.zenoh_publisher import ZenohPublisher


class Publishing(QObject):
    """Publishes patch, force, pose and diagnostics of every sensor of a run.

    Attributes
    ----------
    changed : Signal
        It is on, or off.
    said : Signal
        A `UserMessage`.
    on : bool
    endpoint : str
        Where to listen the next time.
    """

    changed = Signal()
    said = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.on = False
        self.endpoint = LOOPBACK
        self._publisher: ZenohPublisher | None = None
        self._senders: list[ResultSender] = []
        self._forget: list[Callable[[], None]] = []
        self._lock = Lock()
        self._jobs = Jobs("publishing")

    def start(self, run: LiveRun) -> None:
        """Listen at the endpoint and publish what is solved from now on."""
        if self.on:
            return
        self.on, endpoint = True, self.endpoint
        several = len(run.frames) > 1
        for frames, each in zip(run.frames, run.session.sensors, strict=True):
            send = _Sender(self, run)
            sender = ResultSender(frames.stream, send, each.place.name if several else "")
            self._senders.append(sender)
            self._forget.append(frames.listen(sender))
        self._jobs.run(lambda _: _publisher(endpoint), self._on_open)
        self.changed.emit()

    def stop(self) -> None:
        """Publish nothing any more."""
        if not self.on:
            return
        self.on = False
        while self._forget:
            self._forget.pop()()
        self._senders.clear()
        with self._lock:
            publisher, self._publisher = self._publisher, None
        if publisher is not None:
            self._jobs.run(lambda _: publisher.close())
        self.changed.emit()

    def diagnose(self) -> None:
        """Have the diagnostics told that are due."""
        for sender in self._senders:
            sender.diagnose()

    def put(self, message: Message) -> None:
        """Publish a message, in any thread."""
        with self._lock:
            if self._publisher is not None:
                self._publisher.put(*message)

    def close(self) -> None:
        """Stop, and wait until it is done."""
        self.stop()
        self._jobs.close()

    def _on_open(self, done: Done) -> None:
        publisher: ZenohPublisher | None = done.answer
        if publisher is None:
            self.stop()
            self.said.emit(UserMessage("error", f"Not publishing: {done.message}", done.details))
        elif not self.on:
            self._jobs.run(lambda _: publisher.close())
        else:
            with self._lock:
                self._publisher = publisher


class _Sender:
    """Where messages of results go: out, and into the recording while there is one."""

    def __init__(self, publishing: Publishing, run: LiveRun) -> None:
        self._publishing, self._recorder = publishing, run.session.recorder

    def __call__(self, message: Message) -> None:
        self._publishing.put(message)
        if self._recorder.recording:
            self._recorder.push(_raw(message))


def _raw(message: Message) -> RawMessage:
    topic, kind, payload, stamp = message
    return RawMessage(topic, kind, payload, stamp, time.time_ns())


def _publisher(endpoint: str) -> ZenohPublisher:
    # the window starts without the network's library
    from bubbleviz.live.sinks.zenoh_publisher import ZenohPublisher
    from bubbleviz.live.sources.zenoh_session import SessionOptions

    return ZenohPublisher(SessionOptions(f"publish at {endpoint}", None, endpoint))
