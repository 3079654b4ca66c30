"""A message as it arrived, not decoded yet."""

from __future__ import annotations

from dataclasses import dataclass

from bubbleviz.frames.message_decoding import header_stamp_ns


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A serialised ROS 2 message.

    Attributes
    ----------
    topic, type : str
        As in ROS 2: `/depth/image`, `sensor_msgs/msg/Image`.
    payload : bytes
        CDR with its encapsulation header; whatever arrived, it may be garbage.
    stamp_ns : int
        Header stamp, ns; 0 where it is unset or cannot be read.
    arrival_ns : int
        When it arrived here, ns since 1970.
    sequence : int or None
        The publisher's own count, where the transport has one.
    round : int
        How often the source began again from its start: a replayed recording's stamps go back.
    """

    topic: str
    type: str
    payload: bytes
    stamp_ns: int
    arrival_ns: int
    sequence: int | None = None
    round: int = 0


def stamp_of(payload: bytes) -> int:
    """Header stamp of a message that begins with a header, ns; 0 where it has none."""
    try:
        return header_stamp_ns(payload, ros1=False)
    except Exception:  # shorter than a header
        return 0
