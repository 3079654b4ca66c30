"""When requests are served: the latest of each kind, so nothing queues up, and none too early."""

from __future__ import annotations

import time
from threading import Condition

from bubbleviz_ui.engine.requests import (
    AnalyseRequest,
    CollectRequest,
    CompareRequest,
    FollowRequest,
    FrameRequest,
    NewestRequest,
    OpenRequest,
    PatchRequest,
    Request,
    SettleRequest,
)

SLACK_S = 0.004
"""How long a result may wait for the window: a little, so that the window does not wait for it."""
GAIN = 0.4  # of the delay's integral control; chosen
MOST_S = 0.1  # s; longer delays are felt


class RequestSlots:
    """One waiting request of each kind, taken in the order of `ORDER`.

    One that is not due yet is waited for, unless one before it in that order comes.
    """

    ORDER: tuple[type[Request], ...] = (
        OpenRequest,
        FollowRequest,
        CollectRequest,
        PatchRequest,
        FrameRequest,
        NewestRequest,
        SettleRequest,
        CompareRequest,
        AnalyseRequest,
    )

    def __init__(self) -> None:
        self._waiting: dict[type[Request], Request] = {}
        self._changed = Condition()
        self._closed = False

    def put(self, request: Request) -> Request | None:
        """Leave a request; returns the one it replaces, which will never be served.

        A request for a frame also drops one to settle a frame: the user has left it.
        """
        with self._changed:
            replaced = self._waiting.get(type(request))
            if type(request) is FrameRequest:
                self._waiting.pop(SettleRequest, None)
            self._waiting[type(request)] = request
            self._changed.notify()
        return replaced

    def take(self) -> Request | None:
        """Wait for a request; None once the slots are closed."""
        with self._changed:
            while not self._closed:
                first = next((kind for kind in self.ORDER if kind in self._waiting), None)
                wait_s = None if first is None else _due_in_s(self._waiting[first])
                if first is not None and not wait_s:
                    return self._waiting.pop(first)
                self._changed.wait(wait_s)
            return None

    def goes_before_newest(self, request: Request) -> bool:
        """Whether the next frame of a live source is not to be waited for before this."""
        return self.ORDER.index(type(request)) < self.ORDER.index(NewestRequest)

    def close(self) -> None:
        """Wake the taker and let it go."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


def _due_in_s(request: Request) -> float:
    if not isinstance(request, NewestRequest):
        return 0.0
    return max(request.from_s - time.perf_counter(), 0.0)


class RequestDelay:
    """Delays requests while the window draws: a frame taken too early would be old by then.

    Attributes
    ----------
    hold_s : float
        How long after the last result the next frame is to be taken.
    """

    def __init__(self) -> None:
        self.hold_s = 0.0

    def waited(self, seconds: float) -> None:
        """Take note of how long a result waited for the window."""
        self.hold_s = min(max(self.hold_s + GAIN * (seconds - SLACK_S), 0.0), MOST_S)
