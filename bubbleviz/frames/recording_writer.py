"""Frames to a recording: rosbag2 with MCAP storage, zstd."""

from __future__ import annotations

import shutil
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.files.output_files import whole_file
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.message_encoding import Encoding, FrameMessages, ros2_types


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
        self._messages = FrameMessages(encoding, prefix, frame_id)
        self._output: AbstractContextManager[Path] = whole_file(self.path)
        self._temporary: Path
        self._writer: Any = None
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> RecordingWriter:
        # the simulation behind the window's live sensor starts without a writer
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

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
        for topic, kind, payload, stamp in self._messages.of(frame):
            if topic not in self._connections:
                self._connections[topic] = self._writer.add_connection(
                    topic, kind, typestore=ros2_types()
                )
            self._writer.write(self._connections[topic], stamp, payload)
        self.count += 1

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
