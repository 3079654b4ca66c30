"""How a live source is doing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bubbleviz.live.sources.live_source import Link

State = Literal["connecting", "live", "stale", "reconnecting", "ended"]

STALE_AFTER_S = 0.7
"""A source without a depth image for this long is stale: shown within a second."""


@dataclass(frozen=True)
class Status:
    """State of a source.

    Attributes
    ----------
    state : str
        `connecting`: nothing arrived yet. `stale`: connected, but no depth image comes.
    silent_s : float or None
        Time since the last depth image, s; None before the first.
    """

    state: State
    silent_s: float | None

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
            return "waiting for the first depth image"
        if self.state == "live" or self.silent_s is None:
            return ""
        return f"nothing for {self.silent_s:.1f} s"


def status_of(link: Link, silent_s: float | None) -> Status:
    """Status from the state of the connection and the time since the last depth image, s."""
    if link == "ended":
        return Status("ended", silent_s)
    if link == "lost" and (silent_s is None or silent_s > STALE_AFTER_S):
        return Status("reconnecting", silent_s)
    if silent_s is None:
        return Status("connecting", None)
    return Status("stale" if silent_s > STALE_AFTER_S else "live", silent_s)
