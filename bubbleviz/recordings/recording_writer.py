"""Frames to a recording: rosbag2 with MCAP storage, zstd."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bubbleviz.errors import InputError
from bubbleviz.files import whole_file
from bubbleviz.recordings.frame import Frame
from bubbleviz.recordings.mcap_file import McapFile
from bubbleviz.recordings.message_encoding import Encoding, FrameMessages

CHUNK_BYTES = 1 << 20
"""Size of about one depth image, so that reading a frame decompresses little else."""


class RecordingWriter:
    """Writes frames as a recording that `Recording` and every ROS 2 tool reads.

    Use it as a context manager: the recording appears complete when the block ends, and not at all
    if it raises. Topics depend on what the frames have: depth, and possibly camera info, gas
    pressure, wrench and colour images.

    Raises InputError: the path exists or cannot be written, or no frame was written.
    """

    def __init__(
        self,
        path: str | Path,  # `X.mcap` for one bare file, a name without suffix for a rosbag2 folder
        *,
        # depth as float32 m, or as uint16 mm: half the size, rounded to 1 mm, at most 65.5 m
        encoding: Encoding = "32FC1",
        overwrite: bool = False,  # replace an existing recording
    ) -> None:
        self.path = Path(path)
        self.count = 0
        self._messages = FrameMessages(encoding)
        self._open_files = ExitStack()
        self._overwrite = overwrite
        self._file: McapFile

    def __enter__(self) -> RecordingWriter:
        with ExitStack() as stack:
            whole = whole_file(self.path, ".mcap", "", overwrite=self._overwrite)
            temporary = stack.enter_context(whole)
            self._file = McapFile(temporary, name=self.path.name, chunk_bytes=CHUNK_BYTES)
            stack.push(self._finish)
            self._open_files = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._open_files.__exit__(*error)

    def _finish(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None and self.count:
            self._file.close()
            return
        self._file.discard()
        if kind is None:
            raise InputError(
                f"{self.path}: no frames, so nothing was written; choose at least one frame"
            )

    def write(self, frame: Frame) -> None:
        """Append a frame; its stamp is `stamp_ns`, or `time_s` where that is 0."""
        for message in self._messages.of(frame):
            self._file.write(message, log_ns=message.stamp_ns)
        self.count += 1
