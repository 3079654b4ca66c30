"""How a live source is doing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bubbleviz.live.sources.live_source import Link

State = Literal["connecting", "live", "stale", "reconnecting", "ended"]

STALE_AFTER_S = 0.7
"""A source without a depth image for this long is stale: shown within a second."""
STOPPED_AFTER_S = 1.0
"""A source without a depth image for this long has stopped, for who waits for the next one."""


@dataclass(frozen=True)
class Status:
    """State of a source.

    Attributes
    ----------
    state : str
        `connecting`: nothing arrived yet. `stale`: connected, but no depth image comes.
    silent_s : float or None
        Time since the last depth image, s; None before the first.
    problem : str
        Why nothing comes, where that is known.
    """

    state: State
    silent_s: float | None
    problem: str = ""

    @property
    def text(self) -> str:
        """A few words."""
        if self.state == "connecting":
            return self.silence
        return f"{self.state}, {self.silence}" if self.silence else self.state

    @property
    def silence(self) -> str:
        """For how long nothing has come, in a few words; empty where images come."""
        if self.state == "connecting":
            return self.problem or "waiting for the first depth image"
        if self.state == "live" or self.silent_s is None:
            return ""
        return "; ".join(filter(None, (f"nothing for {self.silent_s:.1f} s", self.problem)))


def status_of(link: Link, silent_s: float | None, problem: str = "") -> Status:
    """Status from the connection, the time since the last depth image, s, and what is wrong."""
    if link == "ended":
        return Status("ended", silent_s)
    if link == "lost" and (silent_s is None or silent_s > STALE_AFTER_S):
        return Status("reconnecting", silent_s, problem)
    if silent_s is None:
        return Status("connecting", None, problem)
    if silent_s > STALE_AFTER_S:
        return Status("stale", silent_s, problem)
    return Status("live", silent_s)
