"""Recordings as frames, with random access; messages are read only when needed."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.camera import ColourImage, EncodedImage, Intrinsics
from bubbleviz.errors import InputError, given_path
from bubbleviz.files import as_input_error
from bubbleviz.plugins import plugin
from bubbleviz.recordings.bag import UNREADABLE, Bag, Messages
from bubbleviz.recordings.bag_storage import MAX_SIZE
from bubbleviz.recordings.colour_topics import find_colour
from bubbleviz.recordings.depth_topics import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    MARKERS,
    POINT_CLOUD,
    PRESSURE,
    STRING,
    WRENCH,
    depth_topics,
    find_depth,
    find_intrinsics,
    first_of_type,
    has_data,
    metres_per_unit,
)
from bubbleviz.recordings.frame import Frame, FrameSource, check_index
from bubbleviz.recordings.message_decoding import (
    DEPTH_ENCODINGS,
    decode_cloud,
    decode_depth,
    encoding_of,
)
from bubbleviz.recordings.recorded_colour import ColourAround, RecordedColour, half_step_ns
from bubbleviz.recordings.time_series import (
    GARBAGE_NS,
    NEAREST_NS,
    VALUES,
    Moment,
    Series,
    begins_again,
    plausible_times,
    recorded_series,
    values_at,
)
from bubbleviz.wording import size_text, width_by_height

_PIXEL_BYTES = {name: kind.itemsize for name, kind in DEPTH_ENCODINGS.items()}
SAMPLED_ABOVE = 4096  # images; chosen: opening then takes as long as for that many


class Recording:
    """Frames of a rosbag2 (folder, `.mcap`, `.db3`), a ROS 1 `.bag` or one of a RealSense.

    Frames are ordered by the header stamps of the depth images, or by the log times if any stamp is
    unset or stamps begin again, as in a looped replay. Thread-safe; one thread reads at a time.

    Parameters
    ----------
    path : path-like
    depth_topic, info_topic, pressure_topic, wrench_topic : str, optional
        Topics to use; without them the first depth images, and of the others those of the right
        message type that are nearest by name (and for the camera info: of the image's size), so
        that `depth_topic` alone selects one of two sensors in a recording.

    Raises InputError: the file is missing, damaged or truncated, or has no depth images.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        depth_topic: str | None = None,
        info_topic: str | None = None,
        pressure_topic: str | None = None,
        wrench_topic: str | None = None,
    ) -> None:
        self._lock = threading.Lock()
        self.bag = Bag(path)  # the recording by topics
        self.path = self.bag.path
        self.name = self.path.name or str(self.path)  # file name
        self.note = self.bag.note  # missing parts and other warnings, as text; empty for none
        try:
            self.depth_topic, several = find_depth(self.bag, depth_topic)
            self.note = "; ".join(filter(None, (self.note, several)))
            self._unit_m = metres_per_unit(self.bag, self.depth_topic)
            self._open_images(info_topic)
            _, intrinsics = find_intrinsics(self.bag, self.depth_topic, self.size, info_topic)
            self.intrinsics: Intrinsics | None = intrinsics
            self._series = self._find_values({PRESSURE: pressure_topic, WRENCH: wrench_topic})
            self.colour = self._colour()  # the colour images of the same sensor
        except BaseException:
            self.bag.close()
            raise

    @property
    def depth_topics(self) -> list[str]:
        """Topics of depth images among which `depth_topic` chooses, by name."""
        with self._lock:
            return depth_topics(self.bag)

    def __len__(self) -> int:
        return len(self.times_s)

    def __getitem__(self, index: int) -> Frame:
        """Frame number `index`; IndexError outside 0 … F−1, InputError if it cannot be read."""
        check_index(index, self)
        index = int(index)
        with self._lock, as_input_error(self.path, f"frame {index}"):
            k = int(self._order[index])
            depth = self._empty if index in self._bad else self._decoded(self._images.message(k))
            if depth.shape != self.size[::-1]:
                raise ValueError(
                    f"its image has {width_by_height(depth.shape)} pixels, the first image "
                    f"{size_text(self.size)}"
                )
            return Frame(
                index=index,
                time_s=float(self.times_s[index]),
                depth_m=depth,
                intrinsics=self.intrinsics,
                stamp_ns=int(self.stamps_ns[index]),
                find_colour=partial(self._colour_near, index) if self.colour else None,
                **values_at(self._series, self._moment(index)),
            )

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        with self._lock:
            self.bag.close()

    def colour_at(self, time_s: float) -> ColourImage | None:
        """Colour image nearest to a time of the frames, within half a period; None without one."""
        index = int(np.abs(self.times_s - time_s).argmin())
        return self._colour_near(index, time_s - float(self.times_s[index]))

    @property
    def has_wrench(self) -> bool:
        return WRENCH in self._series

    @property
    def bad_frames(self) -> tuple[int, ...]:
        """Frames whose message is too short for an image; their depth is NaN everywhere.

        If more than 4096 images were stamped when they were logged, only a sample is checked; other
        bad frames are reported when they are read.
        """
        return tuple(sorted(self._bad))

    def gas_pressures_pa(self, at_most: int | None = None) -> np.ndarray:
        """Recorded gas pressures, shape (n,), absolute, Pa; empty where there is none.

        All, or `at_most` of them, spread evenly.
        """
        if (series := self._series.get(PRESSURE)) is None:
            return np.empty(0)
        step = 1 if at_most is None else -(-len(series) // at_most)
        with self._lock, as_input_error(self.path, "the gas pressure"):
            pressures = np.array([series.item(k)[0] for k in range(0, len(series), step)])
        return pressures[np.isfinite(pressures)]

    def marks(self) -> tuple[tuple[int, str], ...]:
        """Markers and notes made while recording: the frame of each, and its text."""
        found = [
            topic for topic in self.bag.topics if (topic.name, topic.type) == (MARKERS, STRING)
        ]
        if not found:
            return ()
        with self._lock, as_input_error(self.path, "the markers"):
            messages = self.bag.messages(found[0])
            return tuple(
                (
                    int(np.abs(self._log_ns - messages.log_ns[k]).argmin()),
                    str(messages.message(k).data),
                )
                for k in range(len(messages))
            )

    def _moment(self, index: int) -> Moment:
        return Moment(int(self.stamps_ns[index]), int(self._log_ns[index]))

    def _colour_near(self, index: int, after_s: float) -> ColourImage | None:
        """Colour image nearest to the time of a frame plus a delay, s."""
        if self.colour is None:
            return None
        time_s = float(self.times_s[index])
        find = ColourAround(self.colour.images, self._moment(index), time_s, self._half_step_ns)
        with self._lock, as_input_error(self.path, f"the colour image at {time_s + after_s:.3f} s"):
            return find(after_s)

    def _colour(self) -> RecordedColour | None:
        topic = find_colour(self.bag, self.depth_topic)
        if topic is None:
            return None
        self._half_step_ns = half_step_ns(self.stamps_ns)

        def reading(read: Callable[[], EncodedImage]) -> EncodedImage:
            with self._lock, as_input_error(self.path, f"a colour image on {topic.name}"):
                return read()

        with as_input_error(self.path, f"the colour images on {topic.name}"):
            return RecordedColour(self.bag, topic, self.depth_topic, reading, by_log=self._by_log)

    def _decoded(self, message: Any) -> np.ndarray:
        if self.depth_topic.type == POINT_CLOUD:
            return decode_cloud(message, self.intrinsics)
        return decode_depth(message, self._unit_m)

    def _is_whole(self, k: int) -> bool:
        try:
            self._decoded(self._images.message(k))
        except (InputError, ValueError):
            return False
        return True

    def _size_of(self, first: Any, info_topic: str | None) -> tuple[int, int]:
        """Width and height of the images; for a cloud without rows, of its camera."""
        if self.depth_topic.type == COMPRESSED_IMAGE:
            with as_input_error(self.path, f"the first image on {self.depth_topic.name}"):
                height, width = decode_depth(first).shape
            return width, height
        if self.depth_topic.type != POINT_CLOUD or first.height > 1:
            return int(first.width), int(first.height)
        info = first_of_type(self.bag, CAMERA_INFO, info_topic, near=self.depth_topic.name)
        if info is None:
            raise InputError(
                f"{self.path}: the points on {self.depth_topic.name} are not organised in rows "
                "and columns; record the camera info with them"
            )
        camera = self.bag.messages(info).first()
        return int(camera.width), int(camera.height)

    def _open_images(self, info_topic: str | None) -> None:
        self._images = self.bag.messages(self.depth_topic)
        if len(self._images) == 0:
            raise InputError(
                f"{self.path}: the index lists no messages on {self.depth_topic.name}; rebuild it "
                "(mcap recover, rosbag reindex), or copy or record again"
            )
        first = self._images.first(has_data)
        self.size = self._size_of(first, info_topic)  # width and height of the depth images, pixels
        if 4 * math.prod(self.size) > MAX_SIZE:
            raise InputError(
                f"{self.path}: images of {size_text(self.size)} pixels (the first one) are "
                "not plausible; copy or record again"
            )
        # encoding of the depth images; `points` where they are point clouds
        self.encoding = encoding_of(first)
        headers, sizes = _headers(self._images)
        self._order_by_time(headers)
        self._find_bad(headers, sizes)

    def _order_by_time(self, headers: np.ndarray) -> None:
        """Order the frames by their stamps (n,), ns, or by log times, see the class."""
        stamps, log_ns = plausible_times(headers, self._images.log_ns)
        arrived = np.argsort(log_ns, kind="stable")
        stamps, log_ns = stamps[arrived], log_ns[arrived]
        looped = bool(stamps.all()) and begins_again(stamps)
        if looped:
            what = "begin again, as in a looped replay" if np.ptp(stamps) else "never advance"
            what = f"stamps of depth images {what}: all data are matched"
            self.note = "; ".join(filter(None, (self.note, f"{what} by log times")))
        self._by_log = looped or not stamps.all()
        if self._by_log:
            stamps = log_ns
        order = np.argsort(stamps, kind="stable")
        self._order, self._log_ns = arrived[order], log_ns[order]
        self.stamps_ns = stamps[order]  # (F,) int64, the stamps they come from, ns
        # (F,), time of each frame since the first, s
        self.times_s = (self.stamps_ns - self.stamps_ns[0]) * 1e-9

    def _find_bad(self, headers: np.ndarray, sizes: np.ndarray) -> None:
        """Find frames without an image, by the headers and sizes of their messages, (n,)."""
        raw = self.depth_topic.type == IMAGE
        least = self.size[0] * self.size[1] * _PIXEL_BYTES.get(self.encoding, 0) if raw else 0
        bad = (headers == UNREADABLE) | (sizes < least)
        if raw:  # those cut by less than a header's length are found only by reading
            shorter = np.flatnonzero(~bad & (sizes < np.median(sizes)))
            bad[shorter] = [not self._is_whole(k) for k in shorter.tolist()]
        if bad.all():
            raise InputError(
                f"{self.path}: all messages on {self.depth_topic.name} are damaged: their "
                f"{np.median(sizes):.0f} bytes do not make an image of {size_text(self.size)} "
                f"pixels in {self.encoding}; check the driver of the camera, and record again"
            )
        self._bad = frozenset(np.flatnonzero(bad[self._order]).tolist())
        self._empty = np.full(self.size[::-1], np.nan, np.float32)  # image of a bad frame
        self._empty.flags.writeable = False

    def _find_values(self, names: dict[str, str | None]) -> dict[str, Series[np.ndarray]]:
        """Series of values measured along with the images, by type; topics may be given."""
        found: dict[str, Series[np.ndarray]] = {}
        self.value_topics: dict[str, str] = {}  # their topics, by type
        for kind, name in names.items():
            topic = first_of_type(self.bag, kind, name, near=self.depth_topic.name)
            messages = None if topic is None else self.bag.messages(topic)
            if messages:  # an index may list none
                values = partial(_values, messages, kind)
                by_log = self._by_log or self._is_of_other_clock(messages)
                found[kind] = recorded_series(messages, values, by_log=by_log)
                self.value_topics[kind] = messages.topic.name
        return found

    def _is_of_other_clock(self, messages: Messages) -> bool:
        """Whether values were logged along with the images but stamped at other times; notes it.

        Also where their clock was set, which `plausible_times` corrects for images alone. Notes
        values logged at other times, too.
        """
        stamps = np.array([messages.stamp_ns(0), messages.stamp_ns(len(messages) - 1)])
        if (stamps <= 0).any():  # unset, or unreadable
            return False
        ahead, name = stamps - messages.log_ns[[0, -1]], messages.topic.name
        ahead_s = (stamps[0] - self.stamps_ns[0]) * 1e-9
        by_log, effect = True, "values are matched by log times"
        if abs(int(ahead[1] - ahead[0])) > GARBAGE_NS:
            what = f"the clock of {name} was set during the recording"
        elif _overlap(stamps, self.stamps_ns):
            return False
        elif _overlap(messages.log_ns, self._log_ns):
            what = f"stamps on {name} are of another clock ({ahead_s:+.1f} s)"
        else:
            what = f"{name} was recorded at another time than the images ({ahead_s:+.1f} s)"
            by_log, effect = False, "its values are not used"
        self.note = "; ".join(filter(None, (self.note, f"{what}: {effect}")))
        return by_log


def _overlap(one_ns: np.ndarray, other_ns: np.ndarray) -> bool:
    """Whether two topics have times in common, within what separates a frame from its values."""
    gap = max(one_ns.min(), other_ns.min()) - min(one_ns.max(), other_ns.max())
    return bool(gap <= NEAREST_NS)


def _values(messages: Messages, kind: str, k: int) -> np.ndarray:
    """Values of message `k`; NaN if it is damaged, or one of them is not finite."""
    if messages.header(k)[0] != UNREADABLE:
        with suppress(InputError, ValueError):
            return VALUES[kind](messages.message(k))
    return np.full(1 if kind == PRESSURE else 6, np.nan)


_ROS_SUFFIXES = {"", ".mcap", ".db3", ".bag", ".yaml"}
"""A recording with one of these needs no search for plug-ins, which takes some 10 ms."""


def open_recording(path: str | Path, **topics: str | None) -> FrameSource:
    """Open a recording of ROS, or of a format that a plug-in reads.

    Parameters
    ----------
    path : path
        A plug-in reads it if its suffix is not one of ROS and a plug-in has that suffix.
    **topics : str or None
        Of `Recording`.

    Raises
    ------
    InputError
        It cannot be opened, or a topic was given for a format without topics.
    """
    path = given_path("recording", path)
    suffix = path.suffix.lower()
    read = None if suffix in _ROS_SUFFIXES else plugin("readers", suffix.removeprefix("."))
    if read is None:
        return Recording(path, **topics)
    if chosen := next(filter(None, topics.values()), None):
        raise InputError(
            f"{path}: a recording of this format has no topics; leave out the topic {chosen}"
        )
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path")
    try:
        opened: FrameSource = read(path)
    except InputError:
        raise
    except Exception as error:  # a plug-in may raise anything
        raise InputError(
            f"{path}: the plug-in for this format failed ({error}); check the file, or update the "
            "plug-in"
        ) from error
    return opened


def _headers(images: Messages) -> tuple[np.ndarray, np.ndarray]:
    """Header stamps of the images, ns, and the sizes of their messages.

    Stamps are 0 if unset and `UNREADABLE` without a header. Reading one decompresses the chunk's
    first blocks (0.1 ms). If all sampled stamps of a long recording equal the log times to the
    nanosecond, all others are assumed to, and to have the same size.
    """
    if len(images) > SAMPLED_ABOVE:
        sample = np.linspace(0, len(images) - 1, 64).astype(int)
        if all(images.header(int(k))[0] == images.log_ns[k] for k in sample):
            return images.log_ns, np.full(len(images), np.iinfo(np.int64).max)
    headers = np.array([images.header(k) for k in range(len(images))], dtype=np.int64)
    return headers[:, 0], headers[:, 1]


# Magnitude of the force measured by a wrench sensor at the bubble.


def measured_force(
    wrench_n: np.ndarray,  # (F, 3), forces as recorded, N; NaN where a frame has none
    contact_free: np.ndarray,  # (F,) bool
    bias_n: np.ndarray | None = None,  # (3,), if it is known
) -> np.ndarray:
    """|F| of recorded wrenches minus their bias, N.

    The axes of a force/torque sensor are rarely documented, so only the magnitude can be compared.
    Its bias, unless it is known, is the median over the contact-free frames.

    Returns
    -------
    (F,) array
        NaN for frames without a wrench, and for all without a bias.
    """
    if bias_n is None:
        free = wrench_n[contact_free & np.isfinite(wrench_n).all(axis=1)]
        bias_n = np.median(free, axis=0) if len(free) else np.full(3, np.nan)
    return np.asarray(np.linalg.norm(wrench_n - bias_n, axis=1))


def force_of(wrench: np.ndarray | None) -> np.ndarray:
    """Force (3,) of a frame's wrench (6,), N; NaN without one."""
    return np.full(3, np.nan) if wrench is None else np.asarray(wrench[:3], float)
