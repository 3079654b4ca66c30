"""Assemble frames from messages: depth, with gas pressure and wrench interpolated at its time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bubbleviz.camera import ColourCamera, ColourImage, EncodedImage, Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.files import MAX_COLOUR_DELAY_S
from bubbleviz.live.live_source import OfferedTopic
from bubbleviz.live.topic_names import DEPTH_TYPES, TopicNames, decode
from bubbleviz.recordings import (
    CAMERA_INFO,
    FORWARD_NS,
    IMAGE,
    NEAREST_NS,
    POINT_CLOUD,
    VALUES,
    ColourAround,
    EqualImages,
    Frame,
    GrowingSeries,
    Message,
    Moment,
    StampClock,
    StaticPoses,
    Verdict,
    are_static_poses,
    belongs_to,
    colour_camera,
    decode_cloud,
    decode_depth,
    decode_intrinsics,
    is_own,
    nearest_info,
    size_of,
    values_at,
)
from bubbleviz.wording import reason_of

KEPT_NS = round(1e9 * MAX_COLOUR_DELAY_S) + NEAREST_NS
"""How long colour images are kept: the longest delay, and the time a frame waits."""


@dataclass(frozen=True)
class KnownCameras:
    """Camera infos and static poses received so far."""

    depth: str  # topic of the depth images; empty until it is known
    depth_frame: str = ""  # their frame of reference
    infos: Mapping[str, Intrinsics] = field(default_factory=dict)  # by topic
    poses: StaticPoses = field(default_factory=StaticPoses)

    def of_colour(self, message: Message) -> ColourCamera:
        """Camera of a colour image."""
        try:
            content = decode(message)
        except ValueError:  # reported when the image is read
            return colour_camera(None, None, own=False)
        pose = self.poses.pose(content.header.frame_id, self.depth_frame)
        info = nearest_info(self.infos, message.topic, size_of(content))
        own = is_own(info, message.topic, self.depth)
        return colour_camera(self.infos.get(info), pose, own=own)


def _read(message: Message) -> EncodedImage:
    try:
        return EncodedImage.of(decode(message))
    except ValueError as error:
        raise InputError(
            f"{message.topic}: the colour image cannot be decoded ({error}); correct its publisher"
        ) from error


# Counters of received and rejected messages.


@dataclass
class Counters:
    """Message counts of one source since it was started."""

    received: int = 0  # messages of every topic
    frames: int = 0  # depth images that became frames
    # out_of_order, duplicate: depth images older than, and as old as, one that came before; no
    # frames
    out_of_order: int = 0
    duplicate: int = 0
    undecodable: int = 0  # messages whose bytes do not match their type
    wrong_type: int = 0  # messages on a topic in use with an unexpected type
    wrong_size: int = 0  # depth images of another size than the sensor's; no frames
    # stamps that are unset, far in the past or far in the future. A depth image with one still
    # becomes a frame, timed by its arrival.
    bad_stamps: int = 0
    equal_in_a_row: int = 0  # depth images in a row equal to the last bit, where a camera hung
    clock_jumps: int = 0  # how often the publisher's clock was set, or the publisher replaced
    missed: int = 0  # messages the publisher counted that never arrived, where the transport counts
    skipped: int = 0  # frames replaced by a newer one before they were taken
    problem: str = ""  # text: the last error


WAIT_NS = 20_000_000
"""How long a frame waits for its gas pressure and wrench, which may arrive later."""
COLOUR_WAIT_NS = NEAREST_NS
"""The same for the colour image, if colour is subscribed to; at most until the next frame."""


class _WrongSizeError(ValueError):
    pass


class _Pending(NamedTuple):
    frame: Frame
    moment: Moment
    half_period_ns: int


class FrameAssembler:
    """Assembles frames from the messages of a source. Not thread-safe.

    No message makes it raise: errors are counted and described in `counters`.
    """

    def __init__(
        self,
        names: TopicNames | None = None,
        *,
        # (int, int), optional, width and height of the sensor's images; of the first image that
        # arrives by default
        size: tuple[int, int] | None = None,
        # of the sensor file, for point clouds without a camera info
        camera: Intrinsics | None = None,
        # how much later than the depth images' the stamps of gas pressure and wrench are for the
        # same moment, s
        lag_s: float = 0.0,
        # stamp of a colour image minus that of the depth image of the same moment, s; where it is
        # positive a frame waits so much longer for the image
        colour_delay_s: float = 0.0,
    ) -> None:
        self.counters = Counters()
        self.equal = EqualImages()
        self._lag_s, self._colour_delay_s = lag_s, colour_delay_s
        self._names = names or TopicNames()
        # size: width and height that images must have; None until the first where any will do
        self.size, self._camera = size, camera
        self.other_size: tuple[int, int] | None = None  # of the last image of a wrong size
        self._known = KnownCameras("")
        self._begin()

    @property
    def depth_frame(self) -> str:
        """Frame of reference of the depth images; empty until one came."""
        return self._known.depth_frame

    def _begin(self) -> None:
        """Reset the state of the stream, but not the counts."""
        self._known = KnownCameras(self._names.depth or "", poses=self._known.poses)
        self._types: dict[str, str] = {}
        self._series: dict[str, GrowingSeries[np.ndarray]] = {}
        self._topics: dict[str, str] = {}
        self._forget_colour()
        self._clock = StampClock()
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._pending: _Pending | None = None
        self._round = 0

    def _forget_colour(self) -> None:
        self._colour_topic = ""  # the first one received
        self._colour = GrowingSeries[Message](KEPT_NS)  # undecoded

    def follow_colour(self, on: bool = True) -> None:
        """Start or stop using colour images."""
        self._names = replace(self._names, with_colour=on)
        if not on:
            self._forget_colour()

    def colour_topic(self, offered: Iterable[OfferedTopic]) -> str:
        """The topic whose colour images belong to the frames, by its name; empty without one."""
        names = self._names
        if names.colour is not None:
            return names.colour
        for topic, kind in offered:
            ours = topic.startswith(names.prefix) and belongs_to(topic, self._known.depth)
            if ours and names.is_colour(topic, kind):
                return topic
        return ""

    def push(self, message: Message) -> list[Frame]:
        """Process a message; returns the frames that it completes, oldest first."""
        self.counters.received += 1
        if message.round != self._round:
            first = self._first_ns
            released = self.flush()
            self._begin()
            self._round, self._first_ns = message.round, first
            return released + self._push(message)
        return self._push(message)

    def _push(self, message: Message) -> list[Frame]:
        """As `push`, without counting, within one round of a looped source."""
        try:
            if are_static_poses(message.topic, message.type):
                poses = self._known.poses.after(decode(message))
                self._known = replace(self._known, poses=poses)
                return []
            if not self._is_ours(message):
                return []
            if self._names.is_colour(message.topic, message.type):
                self._take_colour(message)
            elif message.type == CAMERA_INFO:
                self._take_camera(message)
            elif message.type in VALUES:
                self._take_values(message)
            else:
                return self._take_depth(message)
        except _WrongSizeError as error:
            self.counters.wrong_size += 1
            self._note(message, str(error))
        except Exception as error:  # garbage may be wrong in any way
            self.counters.undecodable += 1
            self._note(message, reason_of(error, 120))
        return self._released(message.arrival_ns)

    def flush(self, now_ns: int | None = None) -> list[Frame]:
        """The pending frame if it has waited long enough, or in any case if the time is None."""
        pending = self._pending
        if pending is None:
            return []
        if now_ns is not None and now_ns < self._deadline(pending):
            return []
        self._pending = None
        self.counters.frames += 1
        return [self._finished(pending)]

    @property
    def waits_until_ns(self) -> int | None:
        """Deadline of the pending frame; None if none is pending."""
        return None if self._pending is None else self._deadline(self._pending)

    def _deadline(self, pending: _Pending) -> int:
        if self._has_colour(pending):
            wait, late_s = WAIT_NS, self._lag_s
        else:
            wait, late_s = COLOUR_WAIT_NS, max(self._lag_s, self._colour_delay_s)
        return pending.frame.arrival_ns + wait + round(max(late_s, 0.0) * 1e9)

    # -- selection of messages --------------------------------------------------------------

    def _is_ours(self, message: Message) -> bool:
        topic, kind = message.topic, message.type
        types = self._names.chosen.get(topic, ())
        expected = types[0] if len(types) == 1 else self._types.get(topic)
        if expected is not None and kind != expected:
            self.counters.wrong_type += 1
            self._note(message, f"a message of type {kind}, expected {expected}")
            return False
        if not self._names.wants(topic, kind):
            return False
        if self._names.is_colour(topic, kind):
            return True
        if kind in DEPTH_TYPES:
            return self._may_be_depth(topic, kind)
        if kind in VALUES:
            return self._topics.setdefault(kind, topic) == topic
        return True

    def _may_be_depth(self, topic: str, kind: str) -> bool:
        """Whether it is the topic in use, the first one, or preferable to it by its name."""
        depth = self._known.depth
        if self._names.depth is not None or depth in ("", topic):
            return True
        return kind == IMAGE and "depth" in topic.lower() and "depth" not in depth.lower()

    # -- decoding ---------------------------------------------------------------------------

    def _take_camera(self, message: Message) -> None:
        camera = decode_intrinsics(decode(message))
        if camera is not None:
            infos = {**self._known.infos, message.topic: camera}
            self._known = replace(self._known, infos=infos)

    def _take_colour(self, message: Message) -> None:
        """Keep an image of the depth images' sensor, or of a topic chosen by name."""
        named = message.topic == self._names.colour
        if not self._colour_topic and (named or belongs_to(message.topic, self._known.depth)):
            self._colour_topic = message.topic
        if message.topic == self._colour_topic:
            verdict = self._colour.add(message.stamp_ns, message.arrival_ns, message)
            self._checked_stamp(message, verdict)

    def _take_values(self, message: Message) -> None:
        values = VALUES[message.type](decode(message))
        series = self._series.setdefault(message.type, GrowingSeries(FORWARD_NS))
        self._checked_stamp(message, series.add(message.stamp_ns, message.arrival_ns, values))

    def _take_depth(self, message: Message) -> list[Frame]:
        depth = self._decoded_depth(message)
        verdict, time_ns = self._clock.check(message.stamp_ns, message.arrival_ns)
        self._checked_stamp(message, verdict)
        if verdict in ("duplicate", "out_of_order"):
            self.counters.duplicate += verdict == "duplicate"
            self.counters.out_of_order += verdict == "out_of_order"
            return self._released(message.arrival_ns)
        if verdict == "jump":
            self.counters.clock_jumps += 1
            self._first_ns = None
        self.equal.take(depth)
        self.counters.equal_in_a_row = self.equal.most if self.equal.warning else 0
        released = self.flush()  # a newer frame ends the wait of the pending one
        if self._first_ns is None:
            self._first_ns = time_ns
        frame = Frame(
            index=self.counters.frames,
            time_s=(time_ns - self._first_ns) * 1e-9,
            depth_m=depth,
            intrinsics=self._intrinsics((depth.shape[1], depth.shape[0])),
            stamp_ns=message.stamp_ns,
            arrival_ns=message.arrival_ns,
            colour_delay_s=self._colour_delay_s,
        )
        step = NEAREST_NS if self._last_ns is None else time_ns - self._last_ns
        self._last_ns = time_ns
        moment = Moment(time_ns, message.arrival_ns)
        self._pending = _Pending(frame, moment, min(max(step, 0), NEAREST_NS) // 2)
        return released + self._released(message.arrival_ns)

    def _checked_stamp(self, message: Message, verdict: Verdict) -> None:
        if verdict == "bad":
            self.counters.bad_stamps += 1
            self._note(message, _bad_stamp(message))

    def _decoded_depth(self, message: Message) -> np.ndarray:
        content: Any = decode(message)
        if message.type == POINT_CLOUD:
            camera = next(iter(self._known.infos.values()), self._camera)
            depth = decode_cloud(content, camera)
        else:
            depth = decode_depth(content)
        size = (depth.shape[1], depth.shape[0])
        if self.size is None:
            self.size = size
        if size != self.size:
            self.other_size = size
            raise _WrongSizeError(
                f"an image has {size[0]}×{size[1]} pixels, expected {self.size[0]}×{self.size[1]}"
            )
        if self._known.depth != message.topic:  # an image that turned out to be depth
            self._clock = StampClock()
        self._types[message.topic] = message.type
        place = {"depth": message.topic, "depth_frame": content.header.frame_id}
        self._known = replace(self._known, **place)
        return depth

    def _intrinsics(self, size: tuple[int, int]) -> Intrinsics | None:
        """Of the camera info nearest to the depth topic by name that is of the image's size."""
        infos, depth = self._known.infos, self._known.depth
        return infos.get(self._names.info or nearest_info(infos, depth, size))

    # -- completion of frames ---------------------------------------------------------------

    def _released(self, now_ns: int) -> list[Frame]:
        pending = self._pending
        if pending is None:
            return []
        moment = self._lagging(pending)
        covered = all(each.covers(moment) for each in self._series.values())
        return self.flush(None if covered and self._has_colour(pending) else now_ns)

    def _has_colour(self, pending: _Pending) -> bool:
        """Whether the colour image of a frame has arrived, or none is expected."""
        late_ns = round(1e9 * self._colour_delay_s)
        return self._colour.covers(pending.moment.later(late_ns))

    def _lagging(self, pending: _Pending) -> Moment:
        """A frame's moment on the clocks of gas pressure and wrench."""
        return pending.moment.later(round(self._lag_s * 1e9))

    def _finished(self, pending: _Pending) -> Frame:
        frame, find_colour, known = pending.frame, None, self._known

        def image(message: Message) -> ColourImage:
            camera = known.of_colour(message)
            return ColourImage(partial(_read, message), message.stamp_ns, camera=camera)

        if self._colour_topic:  # searches the images received so far
            here = self._colour.snapshot(image)
            around = pending.moment, frame.time_s, pending.half_period_ns
            find_colour = ColourAround(here, *around)
        values = values_at(self._series, self._lagging(pending))
        return replace(frame, find_colour=find_colour, **values)

    def _note(self, message: Message, problem: str) -> None:
        self.counters.problem = f"{message.topic}: {problem}"


def _bad_stamp(message: Message) -> str:
    if message.stamp_ns == 0:
        return "no time stamp"
    off = (message.stamp_ns - message.arrival_ns) * 1e-9
    return (
        f"time stamp {_span(abs(off))} {'ahead of' if off > 0 else 'behind'} this computer's clock"
    )


def _span(seconds: float) -> str:
    """A duration as text, in a suitable unit."""
    for name, length in {"days": 86400.0, "hours": 3600.0, "minutes": 60.0}.items():
        if seconds >= 2.0 * length:
            return f"{seconds / length:.0f} {name}"
    return f"{seconds:.3g} s"
