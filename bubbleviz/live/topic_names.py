"""Select the topics of a live source that belong to the sensor, and decode their messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bubbleviz.recordings import (
    CAMERA_INFO,
    COMPRESSED,
    COMPRESSED_IMAGE,
    IMAGE,
    POINT_CLOUD,
    PRESSURE,
    RESULTS,
    WRENCH,
    Message,
    are_static_poses,
    begins_as_cdr,
    header_stamp_ns,
    is_called_colour,
    ros2_types,
)

DEPTH_TYPES = (IMAGE, COMPRESSED_IMAGE, POINT_CLOUD)
TYPES = (*DEPTH_TYPES, CAMERA_INFO, PRESSURE, WRENCH)
"""Message types that are used, hence subscribed to and recorded."""


def is_used(topic: str, kind: str) -> bool:
    """Whether a topic of this type is used where no colour is requested."""
    return kind in TYPES and (kind != COMPRESSED_IMAGE or topic.endswith(f"/{COMPRESSED}"))


@dataclass(frozen=True)
class TopicNames:
    """Topics chosen by name; None for the first that fits."""

    depth: str | None = None  # image, CompressedImage or PointCloud2
    info: str | None = None
    pressure: str | None = None
    wrench: str | None = None
    colour: str | None = None
    prefix: str = ""  # topics without it belong to another sensor
    with_colour: bool = False  # whether colour images are requested

    @property
    def chosen(self) -> dict[str, tuple[str, ...]]:
        """Topics chosen by name, with the types that each may have."""
        roles = {
            self.depth: DEPTH_TYPES,
            self.info: (CAMERA_INFO,),
            self.pressure: (PRESSURE,),
            self.wrench: (WRENCH,),
            self.colour: (IMAGE, COMPRESSED_IMAGE),
        }
        return {name: types for name, types in roles.items() if name is not None}

    def wants(self, topic: str, kind: str) -> bool:
        """Whether messages of a topic and type can be this sensor's."""
        if are_static_poses(topic, kind):  # of any sensor, for the pose of the colour camera
            return self.with_colour
        if not topic.startswith(self.prefix):
            return False
        if self.is_colour(topic, kind):
            return self.with_colour and (self.colour is None or topic == self.colour)
        others = {name: types for name, types in self.chosen.items() if name != self.colour}
        if named := [name for name, types in others.items() if kind in types]:
            return topic in named
        return is_used(topic, kind) and not topic.startswith(RESULTS)

    def is_colour(self, topic: str, kind: str) -> bool:
        """Whether a topic has colour images, by its name."""
        if topic == self.colour:
            return True
        if kind not in (IMAGE, COMPRESSED_IMAGE) or "depth" in topic.lower() or topic == self.depth:
            return False
        return kind == COMPRESSED_IMAGE or is_called_colour(topic)


# Decoding of messages; any damage is a ValueError.


def stamp_of(payload: bytes) -> int:
    """Header stamp of a message that begins with a header, ns; 0 where it has none."""
    try:
        return header_stamp_ns(payload, ros1=False)
    except Exception:  # shorter than a header
        return 0


def decode(message: Message) -> Any:
    """Decode a message by rosbags.

    Raises ValueError: the bytes are not a message of this type.
    """
    payload = message.payload
    if not begins_as_cdr(payload):
        raise ValueError("a message does not begin with a CDR header")
    try:
        return ros2_types().deserialize_cdr(payload, message.type)
    except (Exception, MemoryError) as error:  # rosbags allocates the sizes it reads
        raise ValueError(
            f"a message cannot be decoded as {message.type}: it is damaged or of another type"
        ) from error
