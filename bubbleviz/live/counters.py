"""Counters of received and rejected messages."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass
class Counters:
    """Messages of one source since it was started.

    Attributes
    ----------
    received : int
        Messages of every topic.
    frames : int
        Depth images that became frames.
    out_of_order, duplicate : int
        Depth images older than, and as old as, one that came before; no frames.
    undecodable : int
        Messages whose bytes are not what their type says.
    wrong_type : int
        Messages on a topic of ours with another type than it has for us.
    wrong_size : int
        Depth images of another size than the sensor's; no frames.
    bad_stamps : int
        Stamps that are unset, far in the past or far in the future. A depth image with one is
        a frame all the same, timed by its arrival.
    clock_jumps : int
        How often the publisher's clock was set, or the publisher replaced.
    missed : int
        Messages the publisher counted that never arrived, where the transport counts.
    skipped : int
        Frames that gave way to a newer one before anybody took them.
    problem : str
        The last thing that was wrong, in words.
    """

    received: int = 0
    frames: int = 0
    out_of_order: int = 0
    duplicate: int = 0
    undecodable: int = 0
    wrong_type: int = 0
    wrong_size: int = 0
    bad_stamps: int = 0
    clock_jumps: int = 0
    missed: int = 0
    skipped: int = 0
    problem: str = ""

    def as_dict(self) -> dict[str, int | str]:
        """The counts by name."""
        return asdict(self)
