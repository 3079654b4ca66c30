"""Which topics of a live source are the sensor's."""

from __future__ import annotations

from dataclasses import dataclass

from bubbleviz.colour.colour_topics import is_called_colour
from bubbleviz.colour.static_poses import are_static_poses
from bubbleviz.frames.depth_topics import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    POINT_CLOUD,
    PRESSURE,
    RESULTS,
    WRENCH,
)
from bubbleviz.frames.message_decoding import COMPRESSED

DEPTH_TYPES = (IMAGE, COMPRESSED_IMAGE, POINT_CLOUD)
TYPES = (*DEPTH_TYPES, CAMERA_INFO, PRESSURE, WRENCH)
"""Message types that are used, hence subscribed to and recorded."""


def is_used(topic: str, kind: str) -> bool:
    """Whether messages of a topic and type are, without anybody asking for colour."""
    return kind in TYPES and (kind != COMPRESSED_IMAGE or topic.endswith(f"/{COMPRESSED}"))


@dataclass(frozen=True)
class TopicNames:
    """Topics chosen by name; None for the first that fits.

    Attributes
    ----------
    depth : str or None
        Image, CompressedImage or PointCloud2.
    info, pressure, wrench, colour : str or None
    prefix : str
        Topics that do not begin with it belong to another sensor.
    with_colour : bool
        Whether anybody asks for colour images.
    """

    depth: str | None = None
    info: str | None = None
    pressure: str | None = None
    wrench: str | None = None
    colour: str | None = None
    prefix: str = ""
    with_colour: bool = False

    def expected_type(self, topic: str) -> str | None:
        """Type a topic must have because of what it was chosen for; None where any may do."""
        chosen = {self.info: CAMERA_INFO, self.pressure: PRESSURE, self.wrench: WRENCH}
        return chosen.get(topic)

    def wants(self, topic: str, kind: str) -> bool:
        """Whether messages of a topic and type can be this sensor's."""
        if are_static_poses(topic, kind):  # of every sensor; they tell where the colour camera is
            return self.with_colour
        if not topic.startswith(self.prefix):
            return False
        if self.is_colour(topic, kind):
            return self.with_colour and (self.colour is None or topic == self.colour)
        chosen = {
            **dict.fromkeys(DEPTH_TYPES, self.depth),
            CAMERA_INFO: self.info,
            PRESSURE: self.pressure,
            WRENCH: self.wrench,
        }
        if kind not in chosen:
            return False
        name = chosen[kind]
        if name is not None:
            return topic == name
        return is_used(topic, kind) and not topic.startswith(RESULTS)

    def is_colour(self, topic: str, kind: str) -> bool:
        """Whether a topic has colour images, by its name."""
        if topic == self.colour:
            return True
        if kind not in (IMAGE, COMPRESSED_IMAGE) or "depth" in topic.lower() or topic == self.depth:
            return False
        return kind == COMPRESSED_IMAGE or is_called_colour(topic)
