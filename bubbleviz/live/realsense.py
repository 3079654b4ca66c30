"""RealSense cameras on this computer, and recordings of the RealSense viewer."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bubbleviz.camera import ColourCamera, ColourImage, EncodedImage, Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.live.live_source import Deliver, LiveSource, OfferedTopic, SourceUri
from bubbleviz.plugins import library
from bubbleviz.recordings import IMAGE, Frame, FrameMessages, Message, distortion_of, ros2_types
from bubbleviz.wording import reason_of

FILES = (".bag", ".db3")
"""Formats of the SDK's recordings: ROS 1 bags until 2.57, SQLite files (rosbag2) since."""

_POLL_S = 0.5  # s between checks for a request to stop; chosen
_WORKED_S = 5.0  # s that a camera has to stream before its loss counts as a new one; chosen
_QUEUE = 64  # pictures between the SDK's thread and ours, two seconds at 30 Hz

_ENCODINGS = {name: name for name in ("rgb8", "bgr8", "rgba8", "bgra8")} | {"y8": "mono8"}


class RealSenseLive(LiveSource):
    """Depth, and colour on request, of a RealSense camera through the SDK.

    Reconnects to a camera that was unplugged.
    """

    def __init__(
        self,
        sdk: Any,  # `pyrealsense2`
        *,
        serial: str | None = None,  # of the camera; the first one found by default
        file: Path | None = None,  # a recording instead of a camera
        size: tuple[int, int] = (640, 480),  # width and height to ask a camera for, pixels
        rate: int = 30,  # frames a second to ask a camera for
        exposure_ms: float | None = None,  # of a camera's depth images; by default as it is set
        loop: bool = False,  # begin a recording again at its end
        prefix: str = "/bubble",  # prefix of the topics
    ) -> None:
        super().__init__(str(file.name if file else serial or "RealSense"))
        self._sdk, self._serial, self._file = sdk, serial, file
        self._size, self._rate, self._exposure_ms, self._loop = size, rate, exposure_ms, loop
        self._messages = FrameMessages("32FC1", prefix)

    def _run(self, deliver: Deliver) -> None:
        """Stream; reopens a camera when colour is requested, and restarts a looped file."""
        played = 0
        while not self._stopped.is_set():
            before, again = time.monotonic(), False
            try:
                again = self._stream(deliver, played)
            except InputError as error:
                self.problem = str(error)
            except RuntimeError as error:  # the SDK raises nothing else
                camera = "reconnect the camera, or close other programs that use it"
                remedy = camera if self._file is None else "choose another file"
                self.problem = f"{reason_of(error, 160)}; {remedy}"
            if again or (self._file is not None and self._loop and not self.problem):
                played += 1
                continue
            if self._file is not None:
                break
            if self.link == "up":
                self.link = "lost"
            self._wait_to_retry(anew=time.monotonic() - before > _WORKED_S)

    def _stream(self, deliver: Deliver, played: int) -> bool:
        """Stream until stopped, or the camera is lost; True to reopen it with colour."""
        pictures: queue.Queue[_Picture] = queue.Queue(_QUEUE)
        ros2_types().hash_rihs01(IMAGE)  # loads rosbags, which is slow, before frames come
        device = self._device()
        sensor = device.first_depth_sensor()
        depth = self._depth_profile(sensor)
        if self._exposure_ms is not None:
            set_exposure(self._sdk, sensor, self._exposure_ms)
        offered = _Colour.of(self._profiles(device, "color"), depth)
        if offered is not None:
            self._offer(OfferedTopic(self._messages.colour_topic, IMAGE))
        opened: list[tuple[Any, list[Any]]] = [(sensor, [depth])]
        colour = offered if self._with_colour else None
        if colour is not None and colour.sensor.is_depth_sensor():
            opened[0][1].append(colour.profile)
        elif colour is not None:
            opened.append((colour.sensor, [colour.profile]))
        camera = _intrinsics(depth.as_video_stream_profile().intrinsics)
        to_messages = _Pictures(self._messages, float(sensor.get_depth_scale()), camera, colour)
        enough = threading.Event()
        # without the SDK's pipeline, which drops late frames of a recording
        with ExitStack() as stack:
            if self._file is not None:
                stack.callback(_finish_reading, device)
            for each, profiles in opened:
                each.open(profiles)
                stack.callback(each.close)
            for each, _ in opened:
                each.start(self._receiver(pictures, enough))
                stack.callback(each.stop)
            stack.callback(enough.set)  # a sensor stops only once its callback has returned
            reopen = offered is not None and colour is None
            return self._send(deliver, played, device, pictures, to_messages, reopen=reopen)

    def _send(
        self,
        deliver: Deliver,
        played: int,
        device: Any,
        pictures: queue.Queue[_Picture],
        to_messages: _Pictures,
        *,
        reopen: bool,
    ) -> bool:
        """As `_stream`; `reopen` when colour is requested."""
        began: tuple[float, int] | None = None
        last: _Picture | None = None
        while not self._stopped.is_set():
            if self._with_colour and reopen:
                return True
            try:
                picture = pictures.get(timeout=_POLL_S)
            except queue.Empty:
                if self._is_gone(device):
                    break
                continue
            if picture.colour and not self._with_colour:
                continue
            arrival_ns = picture.arrival_ns
            if self._file is not None:  # when it is due
                began = began or (time.monotonic(), picture.stamp_ns)
                if not self._wait_until(began[0] + (picture.stamp_ns - began[1]) * 1e-9):
                    break
                arrival_ns = time.time_ns()
            if not picture.colour:
                if last is not None:
                    self.missed += max(picture.number - last.number - 1, 0)
                last = picture
            for made in to_messages.of(picture):
                self._offer(OfferedTopic(made.topic, made.type))
                number = picture.number
                deliver(made._replace(arrival_ns=arrival_ns, sequence=number, round=played))
            self.link, self.problem = "up", ""
        return False

    def _offer(self, topic: OfferedTopic) -> None:
        if topic not in self.topics:
            self.topics = (*self.topics, topic)

    def _receiver(self, pictures: queue.Queue[_Picture], enough: threading.Event) -> Any:
        """Callback for the SDK's thread; it also paces the playback of a recording."""

        def receive(frame: Any) -> None:
            seen = frame.as_video_frame()
            if not seen:
                return
            picture = _Picture(
                np.asanyarray(seen.get_data()).copy(),
                int(seen.get_frame_number()),
                max(round(float(seen.get_timestamp()) * 1e6), 1),
                time.time_ns(),
                seen.get_profile().stream_type() == self._sdk.stream.color,
            )
            while not enough.is_set():
                try:
                    pictures.put(picture, timeout=_POLL_S)
                    break
                except queue.Full:
                    if self._file is None:
                        break

        return receive

    def _device(self) -> Any:
        context = self._sdk.context()
        if self._file is not None:
            device = context.load_device(str(self._file))
            device.set_real_time(False)
            return device
        number = self._sdk.camera_info.serial_number
        for device in context.query_devices():
            if self._serial in (None, device.get_info(number)):
                return device
        raise InputError("the camera is not connected; plug it in")

    def _depth_profile(self, sensor: Any) -> Any:
        """Stream profile: depth as requested, or as recorded."""
        for profile in self._fitting(sensor, "depth"):
            if profile.format() == self._sdk.format.z16:
                return profile
        if self._file is not None:
            raise InputError("no 16-bit depth stream in this file; choose another file")
        width, height = self._size
        raise InputError(
            f"no depth stream of {width}×{height} pixels at {self._rate} Hz; change rate=, connect "
            "it by USB 3, or choose the sensor file of this camera"
        )

    def _profiles(self, device: Any, stream: str) -> Iterator[tuple[Any, Any]]:
        """Sensors of a device with their profiles of a stream."""
        for sensor in device.query_sensors():
            for profile in self._fitting(sensor, stream):
                yield sensor, profile

    def _fitting(self, sensor: Any, stream: str) -> Iterator[Any]:
        """Profiles of a stream as requested, or as recorded."""
        for profile in sensor.get_stream_profiles():
            if profile.stream_type() != getattr(self._sdk.stream, stream):
                continue
            video = profile.as_video_stream_profile()
            size = (video.width(), video.height())
            if self._file is not None or (size == self._size and profile.fps() == self._rate):
                yield profile

    def _is_gone(self, device: Any) -> bool:
        if self._file is None:
            return self._serial not in (None, *serials(self._sdk)) or not serials(self._sdk)
        return bool(device.current_status() == self._sdk.playback_status.stopped)


def set_exposure(sdk: Any, sensor: Any, exposure_ms: float) -> None:
    """Fix the exposure time of a sensor, ms.

    Raises InputError: the camera has no such exposure.
    """
    time, automatic = sdk.option.exposure, sdk.option.enable_auto_exposure
    if not sensor.supports(time):
        raise InputError("the exposure of this camera cannot be set; leave exposure= out")
    range_us = sensor.get_option_range(time)
    if not range_us.min <= 1e3 * exposure_ms <= range_us.max:
        raise InputError(
            f"exposure={exposure_ms:g}: this camera has {1e-3 * range_us.min:g} to "
            f"{1e-3 * range_us.max:g} ms; choose one of them"
        )
    if sensor.supports(automatic):
        sensor.set_option(automatic, 0.0)
    sensor.set_option(time, 1e3 * exposure_ms)


def _finish_reading(device: Any) -> None:
    """Wait until the SDK's reading thread is done with a recording that is closed.

    The SDK (2.59) may destroy its reader while that thread begins its next step, which then
    crashes. `pause` returns when everything queued before it is done; the second call waits for
    steps queued during the first.
    """
    for _ in range(2):
        device.pause()


class _Picture(NamedTuple):
    raw: np.ndarray
    number: int
    stamp_ns: int
    arrival_ns: int
    colour: bool


class _Colour(NamedTuple):
    sensor: Any
    profile: Any
    encoding: str
    camera: ColourCamera

    @classmethod
    def of(cls, offered: Iterator[tuple[Any, Any]], depth: Any) -> _Colour | None:
        """The first profile in a known encoding; None without one."""
        for sensor, profile in offered:
            encoding = _ENCODINGS.get(str(profile.format()).rsplit(".", 1)[-1])
            if encoding is not None:
                lens = _intrinsics(profile.as_video_stream_profile().intrinsics)
                pose = _pose(profile, depth)
                camera = ColourCamera(
                    lens, np.eye(4) if pose is None else pose, placed=pose is not None
                )
                return cls(sensor, profile, encoding, camera)
        return None


def _pose(profile: Any, base: Any) -> np.ndarray | None:
    """Pose (4, 4) of a stream's camera in another's; None if unknown."""
    pose = np.eye(4)
    try:
        found = profile.get_extrinsics_to(base)
    except RuntimeError:
        return None
    pose[:3, :3] = np.reshape(found.rotation, (3, 3)).T  # column-major
    pose[:3, 3] = found.translation
    return pose


class _Pictures(NamedTuple):
    """Pictures of one stream to messages."""

    messages: FrameMessages
    unit_m: float
    camera: Intrinsics
    colour: _Colour | None

    def of(self, picture: _Picture) -> Iterator[Message]:
        raw = picture.raw
        if not picture.colour:
            depth_m = raw.astype(np.float32) * np.float32(self.unit_m)
            depth_m[raw == 0] = np.nan
            frame = Frame(picture.number, 0.0, depth_m, self.camera, stamp_ns=picture.stamp_ns)
            yield from self.messages.of(frame)
        elif self.colour is not None:
            height, width = raw.shape[:2]
            step = raw.strides[0]
            encoded = EncodedImage(self.colour.encoding, raw.tobytes(), width, height, step)
            image = ColourImage(lambda: encoded, camera=self.colour.camera)
            yield from self.messages.of_colour(image, picture.stamp_ns)


def open_realsense(uri: SourceUri, size: tuple[int, int], prefix: str) -> RealSenseLive:
    """Source of `realsense:[serial | file]`.

    Raises InputError: the package, the file or the camera does not exist.
    """
    instead = "publish the camera over Zenoh"
    sdk = library("pyrealsense2", "realsense", f'--source "{uri.text}"', instead)
    if Path(uri.place).suffix.lower() in FILES:
        file = Path(uri.place)
        if not file.is_file():
            raise uri.refusal(f"{file}: no such file, or no access to it; check the path")
        if uri.options.exposure is not None:
            raise uri.refusal("the exposure of a file cannot be changed; leave exposure= out")
        return RealSenseLive(sdk, file=file, loop=uri.options.loop, prefix=prefix)
    found = serials(sdk)
    if not found:
        raise uri.refusal(
            "no RealSense camera on this computer, or no access to it; plug one in, check its USB "
            "permissions (udev rules), or give a .bag or .db3 file of the RealSense viewer"
        )
    if uri.place and uri.place not in found:
        raise uri.refusal(
            f"no camera with serial number {uri.place}; choose one of {', '.join(found)}"
        )
    options = uri.options
    return RealSenseLive(
        sdk,
        serial=uri.place or None,
        size=size,
        rate=options.rate,
        exposure_ms=options.exposure,
        prefix=prefix,
    )


def serials(sdk: Any) -> tuple[str, ...]:
    number = sdk.camera_info.serial_number
    return tuple(str(device.get_info(number)) for device in sdk.context().query_devices())


def _intrinsics(found: Any) -> Intrinsics:
    """Convert intrinsics; ValueError for an unsupported distortion model."""
    model = str(found.model).rsplit(".", 1)[-1]
    distortion = distortion_of(model, np.array(found.coeffs, np.float64))
    fx, fy, cx, cy = (float(value) for value in (found.fx, found.fy, found.ppx, found.ppy))
    return Intrinsics(int(found.width), int(found.height), fx, fy, cx, cy, *distortion)
