"""Frames to ROS 2 messages, serialised as CDR."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from bubbleviz.camera import COMPRESSED_ENCODINGS, ColourImage, EncodedImage, Intrinsics
from bubbleviz.files import pose_numbers
from bubbleviz.recordings.bag import typestore
from bubbleviz.recordings.colour_topics import STATIC_TRANSFORMS, TRANSFORMS
from bubbleviz.recordings.depth_topics import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, PRESSURE, WRENCH
from bubbleviz.recordings.frame import Frame

Encoding = Literal["32FC1", "16UC1"]

NAMES = {
    IMAGE: "depth/image_raw",
    CAMERA_INFO: "depth/camera_info",
    PRESSURE: "pressure",
    WRENCH: "wrench",
}
"""Topic of each message type, after the prefix."""
COLOUR_NAMES = {
    IMAGE: "color/image_raw",
    COMPRESSED_IMAGE: "color/image_raw/compressed",
    CAMERA_INFO: "color/camera_info",
}
"""The same for the colour camera."""


class Message(NamedTuple):
    # topic, type: as in ROS 2: `/depth/image`, `sensor_msgs/msg/Image`
    topic: str
    type: str
    payload: bytes  # CDR with its encapsulation header; from a live source it may be invalid
    stamp_ns: int = 0  # header stamp, ns; 0 where it is unset or cannot be read
    arrival_ns: int = 0  # arrival of a live message, ns since 1970; else 0
    sequence: int | None = None  # the publisher's own count, where the transport has one
    # how often the source restarted: the stamps of a looped replay go back
    round: int = 0


def ros2_types() -> Any:
    return typestore(ros1=False)


def make_header(stamp_ns: int, frame_id: str) -> Any:
    """`std_msgs/Header` of a time and a frame of reference."""
    kinds = ros2_types().types
    time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    return kinds["std_msgs/msg/Header"](time, frame_id)


def make_wrench(header: Any, values: np.ndarray) -> Any:
    """`geometry_msgs/WrenchStamped` of force in N and torque in N·m, (6,)."""
    kinds = ros2_types().types
    vector, wrench = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Wrench"]
    numbers = [float(value) for value in values]
    return kinds[WRENCH](header, wrench(vector(*numbers[:3]), vector(*numbers[3:])))


def make_pose(pose: np.ndarray) -> Any:
    """`geometry_msgs/Pose` of a pose (4, 4)."""
    kinds, (x, y, z, *turn) = ros2_types().types, pose_numbers(pose)
    place = kinds["geometry_msgs/msg/Point"](x, y, z)
    return kinds["geometry_msgs/msg/Pose"](place, kinds["geometry_msgs/msg/Quaternion"](*turn))


def make_static_pose(parent: str, child: str, pose: np.ndarray, stamp_ns: int) -> Message:
    """Message on `/tf_static` of T_parent_child (4, 4), which does not change."""
    kinds, (x, y, z, *turn) = ros2_types().types, pose_numbers(pose)
    transform = kinds["geometry_msgs/msg/Transform"](
        kinds["geometry_msgs/msg/Vector3"](x, y, z),
        kinds["geometry_msgs/msg/Quaternion"](*turn),
    )
    stamped = kinds["geometry_msgs/msg/TransformStamped"](make_header(0, parent), child, transform)
    content = kinds[TRANSFORMS]([stamped])
    return Message(STATIC_TRANSFORMS, TRANSFORMS, serialise(content, TRANSFORMS), stamp_ns)


def serialise(message: Any, kind: str) -> bytes:
    return bytes(ros2_types().serialize_cdr(message, kind))


class FrameMessages:
    """Makes the messages of frames: depth and, where there are, camera info and other measurements.

    The colour image keeps its recorded bytes.
    """

    def __init__(
        self,
        # depth as float32 m, or as uint16 mm: half the size, rounded to 1 mm, at most 65.5 m
        encoding: Encoding = "32FC1",
        # prefix of the topics, and of the name of the depth camera's frame in the headers
        prefix: str = "/bubble",
    ) -> None:
        self._encoding, self._prefix = encoding, prefix.rstrip("/")
        self._frame_id = f"{prefix.strip('/').replace('/', '_')}_depth_optical_frame"

    @property
    def colour_topic(self) -> str:
        """Topic of colour images that are not compressed."""
        return f"{self._prefix}/{COLOUR_NAMES[IMAGE]}"

    def of(self, frame: Frame, stamp_ns: int | None = None) -> Iterator[Message]:
        """Messages of a frame, stamped `stamp_ns`, its own stamp, or its `time_s` where that is 0.

        The depth image comes last: the data that belong to it have arrived before it.
        """
        stamp = stamp_ns or frame.stamp_ns or max(round(frame.time_s * 1e9), 1)  # 0: unset
        header = make_header(stamp, self._frame_id)
        if frame.intrinsics is not None:
            yield self._message(CAMERA_INFO, _camera_info(header, frame.intrinsics), stamp)
        if frame.gas_pressure_pa is not None:
            pressure = ros2_types().types[PRESSURE]
            value = pressure(header, fluid_pressure=frame.gas_pressure_pa, variance=0.0)
            yield self._message(PRESSURE, value, stamp)
        if frame.wrench is not None:
            yield self._message(WRENCH, make_wrench(header, frame.wrench), stamp)
        if (colour := frame.colour) is not None:
            yield from self.of_colour(colour, stamp + round(1e9 * (colour.time_s - frame.time_s)))
        yield self._message(IMAGE, self._image(header, frame.depth_m), stamp)

    def of_colour(self, colour: ColourImage, stamp: int) -> Iterator[Message]:
        """Image, its own camera info, and the colour camera's pose where it is not the depth's.

        If that is not known, the image has a frame of reference of unknown pose.
        """
        camera, frame_id = colour.camera, self._frame_id
        if not (camera.placed and np.array_equal(camera.T_D_C, np.eye(4))):
            frame_id = f"{frame_id}_color"
        if camera.placed and frame_id != self._frame_id:
            yield make_static_pose(self._frame_id, frame_id, camera.T_D_C, stamp)
        header = make_header(stamp, frame_id)
        if camera.intrinsics is not None and camera.own:
            info = _camera_info(header, camera.intrinsics)
            yield self._message(CAMERA_INFO, info, stamp, COLOUR_NAMES)
        image = _image(header, colour.read())
        yield self._message(image.__msgtype__, image, stamp, COLOUR_NAMES)

    def _message(
        self, kind: str, message: Any, stamp: int, names: dict[str, str] = NAMES
    ) -> Message:
        return Message(f"{self._prefix}/{names[kind]}", kind, serialise(message, kind), stamp)

    def _image(self, header: Any, depth_m: np.ndarray) -> Any:
        height, width = depth_m.shape
        if self._encoding == "16UC1":
            millimetres = np.rint(np.nan_to_num(depth_m, posinf=0.0, neginf=0.0) * 1e3)
            pixels = np.clip(millimetres, 0, 65_535).astype("<u2")
        else:
            pixels = np.ascontiguousarray(depth_m, dtype="<f4")
        step = width * pixels.itemsize
        return _image(header, EncodedImage(self._encoding, pixels.tobytes(), width, height, step))


def _image(header: Any, encoded: EncodedImage) -> Any:
    """`sensor_msgs/Image` or `sensor_msgs/CompressedImage` with the same bytes."""
    kinds, data = ros2_types().types, np.frombuffer(encoded.data, np.uint8)
    if encoded.encoding in COMPRESSED_ENCODINGS:
        return kinds[COMPRESSED_IMAGE](header, encoded.encoding, data)
    place = (encoded.height, encoded.width, encoded.encoding)
    return kinds[IMAGE](header, *place, is_bigendian=0, step=encoded.step, data=data)


def _camera_info(header: Any, camera: Intrinsics) -> Any:
    region = ros2_types().types["sensor_msgs/msg/RegionOfInterest"]
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    model = "plumb_bob" if camera.distortion_model == "none" else camera.distortion_model
    return ros2_types().types[CAMERA_INFO](
        header=header,
        height=camera.height,
        width=camera.width,
        distortion_model=model,
        d=np.array((*camera.distortion, *[0.0] * 5)[:5]),
        k=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0]),
        r=np.eye(3).ravel(),
        p=np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1.0, 0]),
        binning_x=0,
        binning_y=0,
        roi=region(0, 0, 0, 0, do_rectify=False),
    )
