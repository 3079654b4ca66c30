"""Interface of the live sources."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

from bubbleviz.live.raw_message import RawMessage

Link = Literal["connecting", "up", "lost", "ended"]
"""`lost`: it was up; the source reconnects automatically."""

Deliver = Callable[[RawMessage], None]


class OfferedTopic(NamedTuple):
    """A published topic: its name and its type."""

    name: str
    type: str


class LiveSource(Protocol):
    """Delivers messages from its own threads, in order of arrival and without gaps.

    Attributes
    ----------
    name : str
        What the window's title shows.
    """

    name: str

    def start(self, deliver: Deliver) -> None:
        """Begin; InputError when that is impossible. `deliver` must not raise."""

    def stop(self) -> None:
        """End; nothing is delivered after it returned."""

    def follow_colour(self, on: bool = True) -> None:
        """Deliver colour images, too, from now on, or no more; they are many bytes."""

    def link(self) -> Link:
        """How the connection stands."""

    def topics(self) -> tuple[OfferedTopic, ...]:
        """Topics found so far, of the types that are used here."""

    def missed(self) -> int:
        """Messages lost on the way, by the publishers' sequence numbers; 0 without those."""

    def problem(self) -> str:
        """Failure of the source itself as text; empty without one."""
