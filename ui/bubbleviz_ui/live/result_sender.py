"""Sends the results of one sensor as ROS 2 messages. No Qt in here."""

from __future__ import annotations

import time
from collections.abc import Callable

from bubbleviz.frames.depth_topics import RESULTS
from bubbleviz.frames.message_encoding import Message
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sinks.result_messages import ResultMessages
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.pipeline import Product
from bubbleviz.result import Result

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pose"})
"""What goes out; there is a pose only where an object is followed."""
DIAGNOSTICS_S = 1.0  # s between messages, as is usual in ROS


class ResultSender:
    """Makes messages of the results of a stream.

    Parameters
    ----------
    stream : LiveStream
    send : callable
        Takes a message, in any thread.
    name : str
        Of the sensor, where there are two; part of the topics, and the frame they are in.
    """

    def __init__(self, stream: LiveStream, send: Callable[[Message], None], name: str = "") -> None:
        self._stream, self._send = stream, send
        self._prefix, self._frame_id = f"{RESULTS}{name}", name or "bubble"
        self._mesh: MembraneMesh | None = None
        self._messages: ResultMessages | None = None
        self._last: Result | None = None
        self._told = 0.0

    def __call__(self, result: Result, mesh: MembraneMesh) -> None:
        """Send what there is of a result; in the solver thread."""
        if self._messages is None or mesh is not self._mesh:
            self._mesh, self._messages = mesh, ResultMessages(mesh, self._prefix, self._frame_id)
        self._last = result
        for message in self._messages.of(result):
            self._send(message)

    def diagnose(self) -> None:
        """Say once a second how the source and the estimate are doing."""
        now = time.monotonic()
        if self._messages is not None and now - self._told >= DIAGNOSTICS_S:
            self._told = now
            status, counters = self._stream.status(), self._stream.counters()
            self._send(self._messages.diagnostics(time.time_ns(), status, counters, self._last))
