"""Deserialisation of received messages; any damage is a ValueError."""

from __future__ import annotations

from typing import Any

from bubbleviz.frames.message_encoding import ros2_types
from bubbleviz.live.raw_message import RawMessage


def decode(message: RawMessage) -> Any:
    """Message object of rosbags.

    Raises
    ------
    ValueError
        The bytes are no message of this type.
    """
    payload = message.payload
    if len(payload) < 4 or payload[0] != 0 or payload[1] not in (0, 1):
        raise ValueError("no CDR encapsulation")
    try:
        return ros2_types().deserialize_cdr(payload, message.type)
    except (Exception, MemoryError) as error:  # rosbags believes the sizes it reads
        raise ValueError(f"no {message.type}") from error
