"""RealSense cameras on this computer, and recordings of the RealSense viewer."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.camera.intrinsics import DistortionModel, Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.messages import FrameMessages, ros2_types
from bubbleviz.frames.topics import IMAGE
from bubbleviz.live.message import RawMessage
from bubbleviz.live.pace import PacedThread
from bubbleviz.live.source import Deliver, Link, OfferedTopic
from bubbleviz.live.uri import SourceUri

FILES = (".bag", ".db3")
"""What the SDK records: ROS 1 bags until 2.57, SQLite files since."""

_PATIENCE_MS = 500
_QUEUE = 64
_BACK_OFF_S = (0.5, 4.0)

_MODELS: dict[str, DistortionModel] = {
    "none": "none",
    "brown_conrady": "plumb_bob",
    "inverse_brown_conrady": "inverse_brown_conrady",
}


class RealSenseLive:
    """Depth of a RealSense camera through the SDK; a camera unplugged is looked for again.

    Parameters
    ----------
    sdk : module
        `pyrealsense2`.
    serial : str or None
        Of the camera; the first one found by default.
    file : Path or None
        A recording in place of a camera.
    size : (int, int)
        Width and height to ask a camera for, pixels.
    rate : int
        Frames a second to ask a camera for.
    loop : bool
        Begin a recording again at its end.
    prefix : str
        What the topic names begin with.
    """

    def __init__(
        self,
        sdk: Any,
        *,
        serial: str | None = None,
        file: Path | None = None,
        size: tuple[int, int] = (640, 480),
        rate: int = 30,
        loop: bool = False,
        prefix: str = "/bubble",
    ) -> None:
        self.name = str(file.name if file else serial or "RealSense")
        self._sdk, self._serial, self._file = sdk, serial, file
        self._size, self._rate, self._loop = size, rate, loop
        self._messages = FrameMessages("32FC1", prefix)
        self._link: Link = "connecting"
        self._topics: tuple[OfferedTopic, ...] = ()
        self._thread: PacedThread | None = None
        self._problem = ""
        self._missed = 0

    def start(self, deliver: Deliver) -> None:
        """Begin to stream, in a thread of its own."""
        self._thread = PacedThread(lambda pace: self._run(pace, deliver), self.name)

    def stop(self) -> None:
        """Stop streaming and let go of the camera."""
        if self._thread is not None:
            self._thread.stop()
        self._link = "ended"

    def link(self) -> Link:
        """`lost` while the camera is looked for."""
        return self._link

    def topics(self) -> tuple[OfferedTopic, ...]:
        """What a frame is made of, once there is one."""
        return self._topics

    def missed(self) -> int:
        """Frames the camera counted that the SDK never gave."""
        return self._missed

    def problem(self) -> str:
        """What the SDK said last when it failed."""
        return self._problem or ("" if self._thread is None else self._thread.problem)

    def _run(self, pace: PacedThread, deliver: Deliver) -> None:
        wait = _BACK_OFF_S[0]
        while not pace.stopping:
            before = time.monotonic()
            try:
                self._stream(pace, deliver)
            except RuntimeError as error:  # all the SDK raises
                self._problem = " ".join(str(error).split())[:160]
            if self._file is not None or pace.stopping:
                break
            self._link = "lost" if self._topics else "connecting"
            lasted = time.monotonic() - before
            wait = _BACK_OFF_S[0] if lasted > 5.0 else min(2.0 * wait, _BACK_OFF_S[1])
            pace.wait_until(time.monotonic() + wait)
        self._link = "ended"

    def _stream(self, pace: PacedThread, deliver: Deliver) -> None:
        """Until stopped, the recording ended, or the camera is gone."""
        pipeline, queue = self._sdk.pipeline(), self._sdk.frame_queue(_QUEUE, keep_frames=True)
        ros2_types().hash_rihs01(IMAGE)  # rosbags takes its time to load: before frames come
        profile = pipeline.start(self._config(), queue)
        try:
            unit = float(profile.get_device().first_depth_sensor().get_depth_scale())
            last, played = -1, 0
            while not pace.stopping:
                found, frames = queue.try_wait_for_frame(_PATIENCE_MS)
                if not found:
                    if self._is_gone(profile):
                        return
                    continue
                depth = frames.as_frameset().get_depth_frame()
                number = int(depth.get_frame_number())
                if number <= last and self._file is not None:
                    played += 1
                elif last >= 0:
                    self._missed += max(number - last - 1, 0)
                last = number
                self._link, self._problem = "up", ""
                self._send(depth, unit, number, played, deliver)
        finally:
            pipeline.stop()

    def _config(self) -> Any:
        config = self._sdk.config()
        if self._file is not None:
            config.enable_device_from_file(str(self._file), self._loop)
            return config
        if self._serial is not None:
            config.enable_device(self._serial)
        width, height = self._size
        stream, kind = self._sdk.stream.depth, self._sdk.format.z16
        config.enable_stream(stream, width, height, kind, self._rate)
        return config

    def _is_gone(self, profile: Any) -> bool:
        if self._file is None:
            return self._serial not in (None, *serials(self._sdk)) or not serials(self._sdk)
        status = profile.get_device().as_playback().current_status()
        return bool(status == self._sdk.playback_status.stopped) and not self._loop

    def _send(self, depth: Any, unit: float, number: int, played: int, deliver: Deliver) -> None:
        arrival = time.time_ns()
        raw = np.asanyarray(depth.get_data())
        depth_m = raw.astype(np.float32) * np.float32(unit)
        depth_m[raw == 0] = np.nan
        stamp = max(round(float(depth.get_timestamp()) * 1e6), 1)
        camera = _intrinsics(depth.profile.as_video_stream_profile().intrinsics)
        frame = Frame(number, 0.0, depth_m, camera, stamp_ns=stamp)
        messages = list(self._messages.of(frame))
        self._topics = tuple(OfferedTopic(m.topic, m.type) for m in messages)
        for topic, kind, payload, _ in messages:
            deliver(RawMessage(topic, kind, payload, stamp, arrival, number, played))


def open_realsense(
    uri: SourceUri, size: tuple[int, int], rate: int, *, loop: bool, prefix: str
) -> RealSenseLive:
    """Source of `realsense:[serial | file]`.

    Raises
    ------
    InputError
        The package, the file or the camera is not there.
    """
    try:
        import pyrealsense2 as sdk
    except ImportError as error:
        raise uri.refusal(
            "needs the package pyrealsense2, which is not installed; pip install "
            "'bubbleviz[realsense]', or publish the camera over Zenoh"
        ) from error
    if Path(uri.place).suffix.lower() in FILES:
        file = Path(uri.place)
        if not file.is_file():
            raise uri.refusal(f"{file}: no such file; check the path")
        return RealSenseLive(sdk, file=file, loop=loop, prefix=prefix)
    found = serials(sdk)
    if not found:
        raise uri.refusal(
            "no RealSense camera on this computer; plug one in, or give a file recorded by the "
            "RealSense viewer"
        )
    if uri.place and uri.place not in found:
        raise uri.refusal(f"no camera {uri.place}; there are {', '.join(found)}")
    return RealSenseLive(sdk, serial=uri.place or None, size=size, rate=rate, prefix=prefix)


def serials(sdk: Any) -> tuple[str, ...]:
    """Serial numbers of the cameras on this computer."""
    number = sdk.camera_info.serial_number
    return tuple(str(device.get_info(number)) for device in sdk.context().query_devices())


def _intrinsics(found: Any) -> Intrinsics:
    """Intrinsics as ours; InputError for a distortion model that we do not have."""
    model = _MODELS.get(str(found.model).rsplit(".", 1)[-1])
    coefficients = tuple(float(c) for c in found.coeffs)
    if not any(coefficients):
        model = "none"
    if model is None:
        raise InputError(f"the camera's distortion model {found.model} is not known")
    return Intrinsics(
        int(found.width),
        int(found.height),
        float(found.fx),
        float(found.fy),
        float(found.ppx),
        float(found.ppy),
        model,
        coefficients if model != "none" else (),
    )
