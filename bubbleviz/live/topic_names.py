"""Which topics of a live source are the sensor's."""

from __future__ import annotations

from dataclasses import dataclass

from bubbleviz.frames.depth_topics import CAMERA_INFO, IMAGE, POINT_CLOUD, PRESSURE, RESULTS, WRENCH

TYPES = (IMAGE, CAMERA_INFO, PRESSURE, WRENCH, POINT_CLOUD)
"""Message types that are used, hence subscribed to and recorded."""


@dataclass(frozen=True)
class TopicNames:
    """Topics chosen by name; None for the first that fits.

    Attributes
    ----------
    depth : str or None
        Image or PointCloud2.
    info, pressure, wrench : str or None
    prefix : str
        Topics that do not begin with it belong to another sensor.
    """

    depth: str | None = None
    info: str | None = None
    pressure: str | None = None
    wrench: str | None = None
    prefix: str = ""

    def expected_type(self, topic: str) -> str | None:
        """Type a topic must have because of what it was chosen for; None where any may do."""
        chosen = {self.info: CAMERA_INFO, self.pressure: PRESSURE, self.wrench: WRENCH}
        return chosen.get(topic)

    def wants(self, topic: str, kind: str) -> bool:
        """Whether messages of a topic and type can be this sensor's."""
        if not topic.startswith(self.prefix):
            return False
        chosen = {
            IMAGE: self.depth,
            POINT_CLOUD: self.depth,
            CAMERA_INFO: self.info,
            PRESSURE: self.pressure,
            WRENCH: self.wrench,
        }
        if kind not in chosen:
            return False
        name = chosen[kind]
        return topic == name or (name is None and not topic.startswith(RESULTS))
