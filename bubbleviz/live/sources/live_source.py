"""What all live sources share: a thread that delivers messages and can be stopped immediately."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Literal, NamedTuple

from bubbleviz.live.raw_message import RawMessage

Link = Literal["connecting", "up", "lost", "ended"]
"""`lost`: it was up; the source reconnects automatically."""

Deliver = Callable[[RawMessage], None]


class OfferedTopic(NamedTuple):
    """A published topic: its name and its type."""

    name: str
    type: str


class LiveSource:
    """Delivers messages from its own thread, in order of arrival and without gaps.

    Parameters
    ----------
    name : str
        What the window's title shows.
    """

    closing_s: float | None = None
    """How long to wait for the thread to end, s."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._link: Link = "connecting"
        self._offered: tuple[OfferedTopic, ...] = ()
        self._missed, self._problem = 0, ""
        self._with_colour = False
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, deliver: Deliver) -> None:
        """Begin; InputError when that is impossible. `deliver` must not raise."""
        self._thread = threading.Thread(
            target=self._main, args=(deliver,), name=self.name, daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End; nothing is delivered after it returned."""
        self._stopped.set()
        if self._thread not in (None, threading.current_thread()):
            self._thread.join(self.closing_s)
        self._link = "ended"

    def follow_colour(self, on: bool = True) -> None:
        """Deliver colour images, too, from now on, or no more; they are many bytes."""
        self._with_colour = on

    def link(self) -> Link:
        """How the connection stands."""
        return self._link

    def topics(self) -> tuple[OfferedTopic, ...]:
        """Topics found so far, of the types that are used here."""
        return self._offered

    def missed(self) -> int:
        """Messages lost on the way, by the publishers' sequence numbers; 0 without those."""
        return self._missed

    def problem(self) -> str:
        """Failure of the source itself as text; empty without one."""
        return self._problem

    def _run(self, deliver: Deliver) -> None:
        """Deliver until the end, or until `_wait_until` says no."""
        raise NotImplementedError

    def _wait_until(self, time_s: float) -> bool:
        """Sleep until a time of `time.monotonic`; False when stopped, True when it is due."""
        return not self._stopped.wait(max(time_s - time.monotonic(), 0.0))

    def _main(self, deliver: Deliver) -> None:
        try:
            self._run(deliver)
        except BaseException as error:  # shown by whoever looks at the source
            self._problem = " ".join(str(error).split()) or type(error).__name__
        finally:
            self._link = "ended"
