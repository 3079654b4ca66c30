"""The simulated sensor as a live source."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache

import numpy as np

from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.message_encoding import FrameMessages, Message
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.live.sources.live_source import Deliver, LiveSource, OfferedTopic


class SyntheticLive(LiveSource):
    """Streams the frames of a simulation round after round, stamped with the present.

    Each frame is encoded once: what is kept are its messages, stamped anew in every round.

    Parameters
    ----------
    name : str
    make : callable
        Makes the simulation; called in the source's own thread.
    rate_hz : float
        Frames a second.
    ahead : bool
        Whether all frames are simulated before the first one is sent, so that the first round
        does not stutter; else each when it is due, late where simulating is slower than the rate.
    messages : FrameMessages, optional
        How frames become messages.
    rounds : int or None
        None streams until stopped.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[], FrameSource],
        rate_hz: float,
        *,
        ahead: bool = True,
        messages: FrameMessages | None = None,
        rounds: int | None = None,
    ) -> None:
        super().__init__(name)
        self._make, self._rate, self._ahead, self._rounds = make, rate_hz, ahead, rounds
        self._messages = messages or FrameMessages()

    def _run(self, deliver: Deliver) -> None:
        simulation = self._make()
        messages_of = cache(lambda k: list(self._messages.of(simulation[k])))
        try:
            for k in range(len(simulation) if self._ahead else 1):
                if self._stopped.is_set():
                    return
                messages_of(k)
            self._offered = tuple(OfferedTopic(m.topic, m.type) for m in messages_of(0))
            self._link = "up"
            self._stream(deliver, messages_of, len(simulation))
        finally:
            simulation.close()

    def _stream(
        self, deliver: Deliver, messages_of: Callable[[int], list[Message]], frames: int
    ) -> None:
        start, epoch, sent = time.monotonic(), time.time_ns(), 0
        total = np.inf if self._rounds is None else self._rounds * frames
        while sent < total and self._wait_until(start + sent / self._rate):
            messages = messages_of(sent % frames)
            later_ns = epoch + round(sent / self._rate * 1e9) - messages[-1].stamp_ns
            for message in messages:
                deliver(_raw(message.later(later_ns), sent))
            sent += 1


def _raw(message: Message, sequence: int) -> RawMessage:
    topic, kind, payload, stamp = message
    return RawMessage(topic, kind, payload, stamp, time.time_ns(), sequence)
