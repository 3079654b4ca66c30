"""Properties of the open source, and texts about a result. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from bubbleviz.files import presets_folder
from bubbleviz.live import State
from bubbleviz.recordings import Frame, Gap, TimeAxis, find_gaps
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.units import DASH, Units

ConnectionState = State | Literal["disconnected"]
"""State of the live connection."""
Badge = ConnectionState | Literal["", "frozen", "simulated"]
"""Status of a live source in one word; empty for a recording."""
NOTHING_OPEN = "nothing open"
"""Title while no source is open."""


@dataclass(frozen=True)
class SourceFacts:
    """Properties of the open source; by default of none, whose only frame is empty."""

    title: str = NOTHING_OPEN
    sensor_name: str = ""
    times_s: np.ndarray = field(default_factory=lambda: np.zeros(1))  # (F,) of the frames, s
    live: bool = False  # Live source, not a recording
    grows: bool = False  # Frames are being added
    remark: str = ""  # Warning for the user, or empty
    marks: tuple[tuple[int, str], ...] = ()  # Frames marked during recording, with their texts
    simulated: bool = False  # Live frames come from a simulation
    # Intervals in which a live source sent nothing; frames dropped by a busy solver do not count
    outages: tuple[Gap, ...] = ()
    colour: bool = False  # Its frames may have colour images
    path: str = ""  # Absolute path of a recording; empty for other sources
    depth_topic: str = ""  # Of a recording of ROS messages
    depth_topics: tuple[str, ...] = ()  # That of this sensor, and of others in the recording
    gas_zero: str = ""  # Zero correction of a recording's gas pressure; empty if none was recorded

    @property
    def is_empty(self) -> bool:
        return self.title == NOTHING_OPEN

    @property
    def frames(self) -> int:
        return len(self.times_s)

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """Intervals without frames."""
        return self.outages if self.grows else find_gaps(self.times_s)

    @cached_property
    def axis(self) -> TimeAxis:
        """Positions of the frames on a timeline."""
        return TimeAxis(self.times_s)

    def same_source(self, other: SourceFacts) -> bool:
        """Whether both describe the same frames; the sensor may differ."""
        own, others = ((facts.path or facts.title, facts.depth_topic) for facts in (self, other))
        return own == others and self.frames == other.frames

    @property
    def rate_hz(self) -> float:
        """Mean frame rate of the camera, Hz; NaN for a single frame."""
        span = float(self.times_s[-1] - self.times_s[0]) if self.frames else 0.0
        return (self.frames - 1) / span if span > 0 else float("nan")

    def frame_text(self, frame: int, units: Units, before_time: str) -> str:
        """Number of a frame, of a recording also the first and last one, and its time."""
        if self.is_empty:
            return f"frame {DASH}"
        of_all = "" if self.grows else f" of 0–{self.frames - 1}"
        time_text = units.time.text(float(self.times_s[frame]))
        return f"frame {frame}{of_all}{before_time}{time_text}"

    def badge(self, connection: ConnectionState, *, frozen: bool) -> Badge:
        """Status in one word; the connection state matters only while frames are added."""
        if not self.live:
            return ""
        if self.grows and connection != "live":
            return connection
        if frozen:
            return "frozen"
        return "simulated" if self.simulated else "live"


# Names of a sensor.


def name_of(sensor: Sensor) -> str | None:
    """Preset name or absolute file of a sensor; None if it was not loaded from a file."""
    if not sensor.file:
        return None
    path = sensor.resolve(sensor.file).absolute()
    if path.parent == presets_folder("sensors").absolute():
        return path.stem
    return str(path)


def file_text(sensor: Sensor) -> str:
    """Origin of a sensor: its file's name, `preset`, or `not saved`."""
    name = name_of(sensor)
    if name is None:
        return "not saved"
    return sensor.file if name.endswith(".toml") else "preset"


def title_text(sensor: Sensor) -> str:
    """Name and file of a sensor."""
    return f"{sensor.name} ({file_text(sensor)})"


NO_RESULT = Result(Frame(-1, 0.0, np.full((1, 1), np.nan, np.float32)))
"""Shown before the first source."""

# Texts about a result, the same wherever the window shows them.

UNTRUSTED_STATUS = {
    "no_data": "no depth data",
    "not_converged": "not converged",
    "implausible": "implausible",
}
"""Title of each status whose numbers must not be used."""
STATUS = {"ok": "ok", "no_contact": "no contact", **UNTRUSTED_STATUS}


def untrusted_text(result: Result) -> str:
    """Why the numbers of a result must not be used; empty if they may."""
    estimate = result.estimate
    if estimate is None or estimate.trusted:
        return ""
    headline = UNTRUSTED_STATUS[estimate.status]
    return f"{headline}: {estimate.reason}" if estimate.reason else headline


def force_text(result: Result, units: Units, *, final: bool = True) -> str:
    """|F| ± half of its 95 % interval, if known; a dash for an untrusted result.

    `final`: Whether it does not depend on the frames drawn before; ≈ marks one that does.
    """
    estimate, patch = result.trusted_estimate, result.trusted_patch
    if estimate is None or patch is None:
        return units.force.text(None)
    force = float(np.linalg.norm(patch.force_n))
    text = units.force.with_interval(force, estimate.force_half_width_n)
    return text if final or estimate.status == "no_contact" else f"≈ {text}"


def friction_text(result: Result, units: Units) -> str:
    """Part of the force by friction ± half of the 95 % interval of the force along it.

    A dash if no friction was estimated.
    """
    estimate, patch = result.trusted_estimate, result.trusted_patch
    if estimate is None or patch is None:
        return units.force.text(None)
    friction = float(np.linalg.norm(patch.tangential_force_n))
    if friction > 0.0:  # an estimated amplitude is never exactly 0
        half_width_n = estimate.half_width_along(patch.tangential_force_n)
        return units.force.with_interval(friction, half_width_n)
    return units.force.text(None if patch.force_n.any() else 0.0)
