"""Frames to a recording: rosbag2 with MCAP storage, zstd."""

from __future__ import annotations

import shutil
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np

from bubbleviz.camera.intrinsics import Intrinsics
from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.topics import CAMERA_INFO, IMAGE, PRESSURE, WRENCH
from bubbleviz.outputs import whole_file

Encoding = Literal["32FC1", "16UC1"]

_NAMES = {
    IMAGE: "depth/image_raw",
    CAMERA_INFO: "depth/camera_info",
    PRESSURE: "pressure",
    WRENCH: "wrench",
}


class RecordingWriter:
    """Writes frames as a recording that `Recording` and every ROS 2 tool reads.

    Use it as a context manager: the recording appears whole when the block ends, and not at all
    when it raises. Topics are made for what the frames have: depth and, where there are, camera
    info, gas pressure and wrench.

    Parameters
    ----------
    path : path-like
        `X.mcap` for one bare file, any other name for a rosbag2 folder.
    encoding : {"32FC1", "16UC1"}
        Depth as float32 m, or as uint16 mm: half the size, rounded to 1 mm, at most 65.5 m.
    prefix : str
        What the topic names begin with.
    frame_id : str
        Name of the camera's frame in the headers.

    Raises
    ------
    InputError
        The path exists or cannot be written, or no frame was written.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        encoding: Encoding = "32FC1",
        prefix: str = "/bubble",
        frame_id: str = "bubble_depth_optical_frame",
    ) -> None:
        self.path = Path(path)
        self.count = 0
        self._encoding, self._prefix, self._frame_id = encoding, prefix.rstrip("/"), frame_id
        self._output: AbstractContextManager[Path] = whole_file(self.path)
        self._temporary: Path
        self._writer: Any = None
        self._store: Any = None
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> RecordingWriter:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._temporary = self._output.__enter__()
        # rosbags writes a folder X with X.mcap in it: stage it under its final name
        self._staging = self._temporary.with_suffix(".staging")
        writer = Writer(
            self._staging / self.path.stem, version=9, storage_plugin=StoragePlugin.MCAP
        )
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            writer.open()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        self._writer = writer
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._finish(failed=error is not None)
        except BaseException as second:
            self._output.__exit__(type(second), second, second.__traceback__)
            raise
        finally:
            shutil.rmtree(self._staging, ignore_errors=True)
        self._output.__exit__(kind, error, trace)

    def write(self, frame: Frame) -> None:
        """Append a frame; its stamp is `stamp_ns`, or `time_s` where that is 0."""
        stamp = frame.stamp_ns or max(round(frame.time_s * 1e9), 1)  # 0 would mean unset
        kinds = self._store.types
        header = self._header(stamp)
        self._send(IMAGE, self._image(header, frame.depth_m), stamp)
        if frame.intrinsics is not None:
            self._send(CAMERA_INFO, self._camera_info(header, frame.intrinsics), stamp)
        if frame.gas_pressure_pa is not None:
            message = kinds[PRESSURE](header, fluid_pressure=frame.gas_pressure_pa, variance=0.0)
            self._send(PRESSURE, message, stamp)
        if frame.wrench is not None:
            vector, wrench = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Wrench"]
            values = [float(value) for value in frame.wrench]
            parts = wrench(vector(*values[:3]), vector(*values[3:]))
            self._send(WRENCH, kinds[WRENCH](header, parts), stamp)
        self.count += 1

    def _send(self, kind: str, message: Any, stamp: int) -> None:
        if kind not in self._connections:
            self._connections[kind] = self._writer.add_connection(
                f"{self._prefix}/{_NAMES[kind]}", kind, typestore=self._store
            )
        payload = self._store.serialize_cdr(message, kind)
        self._writer.write(self._connections[kind], stamp, payload)

    def _header(self, stamp: int) -> Any:
        kinds = self._store.types
        time = kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
        return kinds["std_msgs/msg/Header"](time, self._frame_id)

    def _image(self, header: Any, depth_m: np.ndarray) -> Any:
        height, width = depth_m.shape
        if self._encoding == "16UC1":
            millimetres = np.rint(np.nan_to_num(depth_m, posinf=0.0, neginf=0.0) * 1e3)
            pixels = np.clip(millimetres, 0, 65_535).astype("<u2")
        else:
            pixels = np.ascontiguousarray(depth_m, dtype="<f4")
        return self._store.types[IMAGE](
            header=header,
            height=height,
            width=width,
            encoding=self._encoding,
            is_bigendian=0,
            step=width * pixels.itemsize,
            data=pixels.view(np.uint8).reshape(-1),
        )

    def _camera_info(self, header: Any, camera: Intrinsics) -> Any:
        region = self._store.types["sensor_msgs/msg/RegionOfInterest"]
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        model = "plumb_bob" if camera.distortion_model == "none" else camera.distortion_model
        return self._store.types[CAMERA_INFO](
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

    def _finish(self, *, failed: bool) -> None:
        writer, self._writer = self._writer, None
        if writer is None:
            return
        if failed or not self.count:
            writer.abort()
            if not failed:
                raise InputError(f"{self.path}: no frames to write; nothing was written")
            return
        writer.close()
        folder = self._staging / self.path.stem
        bare = self.path.suffix == ".mcap"
        (folder / f"{folder.name}.mcap" if bare else folder).rename(self._temporary)
