"""Crash-safe MCAP writer: the file can be opened up to its last sync."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import bubbleviz
from bubbleviz.files import cannot_write, refuse_existing, sync
from bubbleviz.recordings.message_encoding import Message, ros2_types

CHUNK_BYTES = 4 << 20
"""Size of a chunk before compression; `sync` closes it earlier if data is slow."""


@dataclass(frozen=True)
class Flushed:
    """The part of a recording that remains if writing fails."""

    size_bytes: int = 0
    messages: int = 0
    duration_s: float = 0.0  # from the first message to the last


class McapFile:
    """A rosbag2 recording that is being written: `X.mcap`, or a folder with it and metadata.

    Unlike other outputs it has its final name from the first message on: nothing written is lost,
    and `Recording` and `mcap recover` open an unfinished file up to its last complete chunk.

    Raises InputError: the path exists or cannot be written.
    """

    def __init__(
        self,
        path: str | Path,  # `X.mcap` for one bare file, any other name for a rosbag2 folder
        *,
        name: str = "",  # of the file in a folder, without its suffix; the folder's when empty
        # size before compression; reading one message reads its whole chunk
        chunk_bytes: int = CHUNK_BYTES,
        # LZ4 takes a quarter of the time; a file of depth images is some 1.7 times as large
        compression: Literal["zstd", "lz4"] = "zstd",
    ) -> None:
        from mcap.writer import CompressionType, Writer  # the window starts without it

        self.path = Path(path)
        refuse_existing(self.path)
        self._folder = None if self.path.suffix.lower() == ".mcap" else self.path
        try:
            if self._folder is not None:
                self._folder.mkdir()
            self._file = (
                self.path if self._folder is None else self.path / f"{name or self.path.name}.mcap"
            )
            self._stream = self._file.open("xb")
        except OSError as error:
            raise cannot_write(self.path, error) from error
        self.count = 0  # messages written
        self.synced_bytes = 0  # size that is safely on disk
        self.flushed = Flushed()
        self._first_ns = self._last_ns = 0
        self._channels: dict[tuple[str, str], int] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._writer: Any = Writer(
            self._stream, chunk_size=chunk_bytes, compression=CompressionType[compression.upper()]
        )
        self._writer.start("ros2", f"bubbleviz {bubbleviz.__version__}")
        self.sync()
        sync(self._file.parent)

    def write(self, message: Message, log_ns: int) -> None:
        """Append a message, logged at a time, ns since 1970; OSError if that fails."""
        topic, kind = message.topic, message.type
        if (topic, kind) not in self._channels:
            self._channels[topic, kind] = self._new_channel(topic, kind)
            self._counts[topic, kind] = 0
        log_ns = max(log_ns, 0)
        self._writer.add_message(
            self._channels[topic, kind],
            log_time=log_ns,
            publish_time=max(message.stamp_ns, 0) or log_ns,
            sequence=(message.sequence or 0) & 0xFFFF_FFFF,
            data=message.payload,
        )
        self._counts[topic, kind] += 1
        self._first_ns = min(self._first_ns, log_ns) if self.count else log_ns
        self._last_ns = max(self._last_ns, log_ns)
        self.count += 1

    def flush(self) -> None:
        """Close the chunk and hand it to the system; OSError if that fails."""
        self._writer.flush()
        self._stream.flush()
        duration_s = 1e-9 * (self._last_ns - self._first_ns)
        self.flushed = Flushed(self._stream.tell(), self.count, duration_s)

    def sync(self) -> None:
        """Close the chunk and fsync the file; OSError if that fails."""
        self.flush()
        os.fsync(self._stream.fileno())
        self.synced_bytes = self.flushed.size_bytes

    def close(self) -> None:
        """Finish the file, with the index that makes it quick to open."""
        self._writer.flush()
        self._writer.add_metadata(
            "rosbag2", {"serialized_metadata": json.dumps(self._information())}
        )
        self._writer.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self.synced_bytes = self._stream.tell()
        self._stream.close()
        if self._folder is not None:
            content = {"rosbag2_bagfile_information": self._information()}
            text = json.dumps(content, indent=2)
            (self._folder / "metadata.yaml").write_text(text, "utf-8")

    def discard(self) -> None:
        """Remove the file, as nothing was recorded."""
        self._stream.close()
        self._file.unlink()
        if self._folder is not None:
            self._folder.rmdir()

    def abandon(self) -> None:
        """Close after a failed write; the file stays as of the last flush."""
        descriptor = self._stream.fileno()
        os.ftruncate(descriptor, self.flushed.size_bytes)
        self.synced_bytes = self.flushed.size_bytes
        with Path(os.devnull).open("wb") as nowhere:  # closing writes the buffer, here to nowhere
            os.dup2(nowhere.fileno(), descriptor)
        self._stream.close()

    def _new_channel(self, topic: str, kind: str) -> int:
        types = ros2_types()
        if kind not in self._schemas:
            definition, _ = types.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition.encode())
        metadata = {"offered_qos_profiles": "[]", "topic_type_hash": types.hash_rihs01(kind)}
        channel: int = self._writer.register_channel(topic, "cdr", self._schemas[kind], metadata)
        return channel

    def _information(self) -> dict[str, Any]:
        """The section `rosbag2_bagfile_information` of metadata.yaml, version 9."""
        length_ns = self._last_ns - self._first_ns
        whole: dict[str, Any] = {
            "duration": {"nanoseconds": length_ns},
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "message_count": self.count,
        }
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": kind,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": ros2_types().hash_rihs01(kind),
                },
                "message_count": count,
            }
            for (topic, kind), count in self._counts.items()
        ]
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [self._file.name],
            **whole,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": self._file.name, **whole}],
            "custom_data": None,
            "ros_distro": "bubbleviz",
        }
