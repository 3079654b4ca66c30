"""The colour images that arrived last, undecoded, and those of the time of a frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.colour.colour_image import ColourCamera, ColourImage, EncodedImage
from bubbleviz.colour.colour_topics import belongs_to, colour_camera, size_of
from bubbleviz.colour.static_poses import StaticPoses
from bubbleviz.errors import InputError
from bubbleviz.files.defaults import MOST_COLOUR_DELAY_S
from bubbleviz.frames.depth_topics import common_prefix
from bubbleviz.frames.time_series import NEAREST_NS
from bubbleviz.live.deserialise import decode
from bubbleviz.live.raw_message import RawMessage
from bubbleviz.live.stamps import StampClock, Verdict

KEPT_NS = round(1e9 * MOST_COLOUR_DELAY_S) + NEAREST_NS
"""Images kept: those of the longest delay, and of a frame that is behind them."""


class _Arrived(NamedTuple):
    time_ns: int
    message: RawMessage


class DepthPlace(NamedTuple):
    """Topic of the depth images, their frame of reference, and where others are."""

    topic: str
    frame_id: str
    poses: StaticPoses

    def pose_of(self, frame_id: str) -> np.ndarray | None:
        """Pose (4, 4) of another frame of reference in it; None where it is not known."""
        return self.poses.pose(frame_id, self.frame_id)


class ColourBuffer:
    """Colour images of one topic, as messages.

    Attributes
    ----------
    topic : str
        Empty until there is one.
    """

    def __init__(self) -> None:
        self.topic = ""
        self._clock = StampClock()
        self._arrived: deque[_Arrived] = deque()

    def add(self, message: RawMessage, depth_topic: str, *, named: bool) -> Verdict:
        """Keep an image of the depth images' sensor, or of a topic `named`; verdict on its stamp.

        The topic that comes first counts.
        """
        if not self.topic and (named or belongs_to(message.topic, depth_topic)):
            self.topic = message.topic
        if message.topic != self.topic:
            return "ok"
        verdict, time_ns = self._clock.judge(message.stamp_ns, message.arrival_ns)
        if verdict == "jump":
            self._arrived.clear()
        if verdict not in ("duplicate", "out_of_order"):
            self._arrived.append(_Arrived(time_ns, message))
        while self._arrived[0].time_ns < time_ns - KEPT_NS:
            self._arrived.popleft()
        return verdict

    def covers(self, time_ns: int) -> bool:
        """Whether an image at least as new as a time arrived, or none is expected soon."""
        if not self._arrived:
            return True
        newest = self._arrived[-1].time_ns
        return newest >= time_ns or newest < time_ns - 10 * NEAREST_NS

    def around(
        self,
        time_ns: int,
        time_s: float,
        within_ns: int,
        depth: DepthPlace,
        infos: dict[str, Intrinsics],
    ) -> Callable[[float], ColourImage | None]:
        """What finds the image nearest to a time after a frame, s, among those here now.

        Parameters
        ----------
        time_ns, time_s : int, float
            Of the frame, on its publisher's clock and from the start of the stream.
        within_ns : int
            An image further off is none of that moment.
        depth : DepthPlace
        infos : dict of Intrinsics
            What camera infos told, by topic.
        """
        return _Moment(tuple(self._arrived), time_ns, time_s, within_ns, depth, dict(infos)).image


@dataclass(frozen=True)
class _Moment:
    """Colour images around a frame."""

    arrived: tuple[_Arrived, ...]
    time_ns: int
    time_s: float
    within_ns: int
    depth: DepthPlace
    infos: dict[str, Intrinsics]

    def image(self, after_s: float) -> ColourImage | None:
        wanted_ns = self.time_ns + round(1e9 * after_s)
        nearest = min(self.arrived, key=lambda a: abs(a.time_ns - wanted_ns), default=None)
        if nearest is None or abs(nearest.time_ns - wanted_ns) > self.within_ns:
            return None
        message = nearest.message
        at_s = self.time_s + 1e-9 * (nearest.time_ns - self.time_ns)
        return ColourImage(partial(_read, message), message.stamp_ns, at_s, self._camera(message))

    def _camera(self, message: RawMessage) -> ColourCamera:
        try:
            content = decode(message)
        except ValueError:  # said when the image is read
            return colour_camera(None, None, own=False)
        size, pose = size_of(content), self.depth.pose_of(content.header.frame_id)
        fitting = [topic for topic, c in self.infos.items() if (c.width, c.height) == size]
        if not fitting:
            return colour_camera(None, pose, own=False)
        topic = max(fitting, key=lambda topic: common_prefix(topic, message.topic))
        own = common_prefix(topic, message.topic) >= common_prefix(topic, self.depth.topic)
        return colour_camera(self.infos[topic], pose, own=own)


def _read(message: RawMessage) -> EncodedImage:
    try:
        return EncodedImage.of(decode(message))
    except ValueError as error:
        raise InputError(f"{message.topic}: {error}; check what is published there") from error
