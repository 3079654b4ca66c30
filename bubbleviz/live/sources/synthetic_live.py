"""The simulated sensor as a live source."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.message_encoding import FrameMessages, Message
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.live.sources.live_source import Deliver, Link, OfferedTopic
from bubbleviz.live.sources.paced_thread import PacedThread


class SyntheticLive:
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
        self.name = name
        self._make, self._rate, self._ahead, self._rounds = make, rate_hz, ahead, rounds
        self._messages = messages or FrameMessages()
        self._thread: PacedThread | None = None
        self._topics: tuple[OfferedTopic, ...] = ()

    def start(self, deliver: Deliver) -> None:
        """Begin to simulate, then to stream."""
        self._thread = PacedThread(lambda pace: self._run(pace, deliver), self.name)

    def stop(self) -> None:
        """Stop streaming."""
        if self._thread is not None:
            self._thread.stop()

    def follow_colour(self, on: bool = True) -> None:
        """Nothing: its frames have the colour images they have."""

    def link(self) -> Link:
        """`connecting` while simulating ahead."""
        if self._thread is None or (not self._topics and self._thread.running):
            return "connecting"
        return "up" if self._thread.running else "ended"

    def topics(self) -> tuple[OfferedTopic, ...]:
        """What a frame is made of, once there is one."""
        return self._topics

    def missed(self) -> int:
        """None ever."""
        return 0

    def problem(self) -> str:
        """What ended it early."""
        return "" if self._thread is None else self._thread.problem

    def _run(self, pace: PacedThread, deliver: Deliver) -> None:
        simulation = self._make()
        made: dict[int, list[Message]] = {}

        def messages_of(k: int) -> list[Message]:
            if k not in made:
                made[k] = list(self._messages.of(simulation[k]))
            return made[k]

        try:
            if self._ahead:
                for k in range(len(simulation)):
                    if pace.stopping:
                        return
                    messages_of(k)
            self._stream(pace, deliver, messages_of, len(simulation))
        finally:
            simulation.close()

    def _stream(
        self,
        pace: PacedThread,
        deliver: Deliver,
        messages_of: Callable[[int], list[Message]],
        frames: int,
    ) -> None:
        self._topics = tuple(OfferedTopic(m.topic, m.type) for m in messages_of(0))
        start, epoch, sent = time.monotonic(), time.time_ns(), 0
        total = np.inf if self._rounds is None else self._rounds * frames
        while sent < total and pace.wait_until(start + sent / self._rate):
            messages = messages_of(sent % frames)
            later_ns = epoch + round(sent / self._rate * 1e9) - messages[-1].stamp_ns
            for message in messages:
                deliver(_raw(message.later(later_ns), sent))
            sent += 1


def _raw(message: Message, sequence: int) -> RawMessage:
    topic, kind, payload, stamp = message
    return RawMessage(topic, kind, payload, stamp, time.time_ns(), sequence)
