"""Frames to a recording: rosbag2 with MCAP storage, zstd."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType

from bubbleviz.errors import InputError
from bubbleviz.files.output_files import whole_file
from bubbleviz.frames.bags.mcap_file import McapFile
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.message_encoding import Encoding, FrameMessages

CHUNK_BYTES = 1 << 20
"""About a depth image before compression: reading one frame decompresses little else."""


class RecordingWriter:
    """Writes frames as a recording that `Recording` and every ROS 2 tool reads.

    Use it as a context manager: the recording appears whole when the block ends, and not at all
    when it raises. Topics are made for what the frames have: depth and, where there are, camera
    info, gas pressure, wrench and colour images.

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
    overwrite : bool
        Replace what is at `path`.

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
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self.count = 0
        self._messages = FrameMessages(encoding, prefix, frame_id)
        self._output: AbstractContextManager[Path] = whole_file(self.path, overwrite=overwrite)
        self._file: McapFile

    def __enter__(self) -> RecordingWriter:
        temporary = self._output.__enter__()
        try:
            self._file = McapFile(temporary, name=self.path.name, chunk_bytes=CHUNK_BYTES)
        except BaseException as error:
            self._output.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if error is None and self.count:
                self._file.close()
            else:
                self._file.discard()
            if error is None and not self.count:
                raise InputError(f"{self.path}: no frames to write; nothing was written")
        except BaseException as second:
            self._output.__exit__(type(second), second, second.__traceback__)
            raise
        self._output.__exit__(kind, error, trace)

    def write(self, frame: Frame) -> None:
        """Append a frame; its stamp is `stamp_ns`, or `time_s` where that is 0."""
        for message in self._messages.of(frame):
            self._file.write(message, log_ns=message[3])
        self.count += 1
