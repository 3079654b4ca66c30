"""The colour images that arrived last, undecoded, and those of the time of a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.colour.colour_image import ColourCamera, ColourImage, EncodedImage
from bubbleviz.colour.colour_topics import belongs_to, colour_camera, is_own, size_of
from bubbleviz.colour.recorded_colour import ColourAround
from bubbleviz.colour.static_poses import StaticPoses
from bubbleviz.errors import InputError
from bubbleviz.files.defaults import MOST_COLOUR_DELAY_S
from bubbleviz.frames.depth_topics import nearest_info
from bubbleviz.frames.time_series import NEAREST_NS, GrowingSeries, Moment, Verdict
from bubbleviz.live.deserialise import decode
from bubbleviz.live.raw_message import RawMessage

KEPT_NS = round(1e9 * MOST_COLOUR_DELAY_S) + NEAREST_NS
"""Images kept: those of the longest delay, and of a frame that is behind them."""


class ColourBuffer:
    """Colour images of one topic, as messages.

    Attributes
    ----------
    topic : str
        Empty until there is one.
    arrived : GrowingSeries of RawMessage
    """

    def __init__(self) -> None:
        self.topic = ""
        self.arrived = GrowingSeries[RawMessage](KEPT_NS)

    def add(self, message: RawMessage, depth_topic: str, *, named: bool) -> Verdict:
        """Keep an image of the depth images' sensor, or of a topic `named`; verdict on its stamp.

        The topic that comes first counts.
        """
        if not self.topic and (named or belongs_to(message.topic, depth_topic)):
            self.topic = message.topic
        if message.topic != self.topic:
            return "ok"
        return self.arrived.add(message.stamp_ns, message.arrival_ns, message)

    def around(
        self, moment: Moment, time_s: float, within_ns: int, known: KnownCameras
    ) -> ColourAround:
        """What finds the images around a frame, among those here now."""

        def image(message: RawMessage) -> ColourImage:
            return ColourImage(
                partial(_read, message), message.stamp_ns, camera=known.of_colour(message)
            )

        return ColourAround(self.arrived.snapshot(image), moment, time_s, within_ns)


@dataclass(frozen=True)
class KnownCameras:
    """What camera infos and static poses told so far.

    Attributes
    ----------
    depth : str
        Topic of the depth images; empty until it is known.
    depth_frame : str
        Their frame of reference.
    infos : dict of Intrinsics
        By topic.
    poses : StaticPoses
    """

    depth: str
    depth_frame: str = ""
    infos: Mapping[str, Intrinsics] = field(default_factory=dict)
    poses: StaticPoses = field(default_factory=StaticPoses)

    def of_colour(self, message: RawMessage) -> ColourCamera:
        """Camera of a colour image."""
        try:
            content = decode(message)
        except ValueError:  # said when the image is read
            return colour_camera(None, None, own=False)
        pose = self.poses.pose(content.header.frame_id, self.depth_frame)
        info = nearest_info(self.infos, message.topic, size_of(content))
        own = is_own(info, message.topic, self.depth)
        return colour_camera(self.infos.get(info), pose, own=own)


def _read(message: RawMessage) -> EncodedImage:
    try:
        return EncodedImage.of(decode(message))
    except ValueError as error:
        raise InputError(f"{message.topic}: {error}; check what is published there") from error
