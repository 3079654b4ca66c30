"""What the window says about the open source. No Qt in here."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from bubbleviz.diagnostics import Probed
from bubbleviz.live import State
from bubbleviz.recordings import Gap, TimeAxis, find_gaps
from bubbleviz.result import Result
from bubbleviz_ui.model.units import Units

Link = State | Literal["disconnected"]
"""How what is connected is doing; disconnected while nothing is."""
Badge = Link | Literal["", "frozen", "simulated"]
"""The one word that tells what one looks at; empty for a recording."""
NOTHING_OPEN = "nothing open"
"""Title of what is there while nothing is open."""


@dataclass(frozen=True)
class SourceFacts:
    """What the window says about the open source."""

    title: str  # Name of the source
    sensor_name: str  # Name of the sensor
    times_s: np.ndarray  # (F,) array: Time of each frame, s
    live: bool = False  # A live source, not a recording
    grows: bool = False  # Frames are added while one looks
    remark: str = ""  # What the user should know about it; empty for nothing
    # Frames marked when it was recorded, with the text of each
    marks: tuple[tuple[int, str], ...] = ()
    simulated: bool = False  # Its live frames are a simulation's
    # Where a source that grows sent nothing; what a busy solver left out is none
    outages: tuple[Gap, ...] = ()
    path: str = ""  # Resolved, of a recording's file or folder; empty for what is none
    # What was done to the zero of a recording's gas pressure; empty where none was recorded
    gas_zero: str = ""

    @property
    def nothing(self) -> bool:
        """Whether nothing is open: its one frame is nobody's."""
        return self.title == NOTHING_OPEN

    @property
    def frames(self) -> int:
        """Count the frames."""
        return len(self.times_s)

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """Where frames are missing."""
        return self.outages if self.grows else find_gaps(self.times_s)

    @cached_property
    def axis(self) -> TimeAxis:
        """Where its frames lie on a timeline."""
        return TimeAxis(self.times_s)

    def same_source(self, other: SourceFacts) -> bool:
        """Whether the other facts are of the same frames, with whatever sensor."""
        mine, its = (facts.path or facts.title for facts in (self, other))
        return mine == its and self.frames == other.frames

    @property
    def rate_hz(self) -> float:
        """Mean frame rate of the camera, Hz; NaN for a single frame."""
        span = float(self.times_s[-1] - self.times_s[0]) if self.frames else 0.0
        return (self.frames - 1) / span if span > 0 else float("nan")

    def badge(self, link: Link, *, frozen: bool) -> Badge:
        """Say in one word what one looks at; what is connected counts for frames from there."""
        if not self.live:
            return ""
        if self.grows and link != "live":
            return link
        if frozen:
            return "frozen"
        return "simulated" if self.simulated else "live"


# A frame's force and doubts in words, the same wherever the window shows them. No Qt in here.


DOUBTS = {
    "no_data": "no depth data",
    "not_converged": "not converged",
    "implausible": "implausible",
}
"""Headline of each status without a number to trust."""


def doubt_text(result: Result) -> str:
    """Why the numbers of a result are not to be trusted; empty where they are."""
    estimate = result.estimate
    if estimate is None or estimate.trusted:
        return ""
    headline = DOUBTS[estimate.status]
    return f"{headline}: {estimate.reason}" if estimate.reason else headline


def force_text(result: Result, units: Units) -> str:
    """|F| ± half of its 95 % interval where it is known; a dash where it is not to be trusted."""
    estimate, patch = result.trusted_estimate, result.trusted_patch
    if estimate is None or patch is None:
        return units.force.text(None)
    force = float(np.linalg.norm(patch.force_n))
    return units.force.with_interval(force, estimate.force_half_width_n)


def tangential_text(result: Result, units: Units) -> str:
    """The part of the force that is friction; a dash where no friction was estimated."""
    patch = result.trusted_patch
    if patch is None:
        return units.force.text(None)
    tangential = float(np.linalg.norm(patch.tangential_force_n))
    # An estimated amplitude is never exactly 0.
    estimated = tangential > 0.0 or not patch.force_n.any()
    return units.force.text(tangential if estimated else None)


def pressure_text(place: Probed, units: Units) -> str:
    """Contact pressure at a place, or the pressure there that is not contact."""
    if place.unexplained_pa > 0.0:
        return f"{units.pressure.text(place.unexplained_pa)} without evidence of contact"
    return f"p_c {units.pressure.text(place.pressure_pa)}"
