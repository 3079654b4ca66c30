"""Files of a bag by position: what all have in common, ROS 1 bags and SQLite; MCAP is apart."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bubbleviz.frames.bags.chunks import MAX_SIZE, ChunkCache, FilePart, LazyChunk

_MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}  # no record can begin like these


class Storage(Protocol):
    """One file of a bag. Anything it raises means the file is damaged.

    Attributes
    ----------
    connections : list
        With `id`, `topic`, `msgtype` and `msgcount`, as rosbags has them.
    """

    connections: list[Any]

    def entries(self, channel: int) -> np.ndarray:
        """Log time in ns and position of the messages of a channel, in any order, (n, 3) int64.

        A position is a chunk and an offset; what they mean is the storage's business.
        """

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of the message at a position; only its first `limit` bytes when given."""


def table_of(rows: Any) -> np.ndarray:
    """Rows of three whole numbers, perhaps none, as an array (n, 3)."""
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


class Ros1Storage:
    """Messages of one ROS 1 bag; a position's chunk is where the chunk begins in the file.

    Parameters
    ----------
    reader : rosbags.rosbag1.Reader
        Open; tells the index.
    """

    def __init__(self, reader: Any) -> None:
        self.connections = reader.connections
        self._reader = reader
        self._cache = ChunkCache(self._load)

    def entries(self, channel: int) -> np.ndarray:
        """Positions of the messages of a connection."""
        return table_of([tuple(entry) for entry in self._reader.indexes.get(channel, [])])

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of a message, or its first `limit` bytes."""
        # imported by the reader already
        from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

        with self._cache.at(chunk, offset) as data:
            opcode = RecordType.CONNECTION
            while opcode == RecordType.CONNECTION:  # a message may follow its connection record
                opcode = Header.read(data).get_uint8("op")
                size = read_uint32(data)
                if size > MAX_SIZE:
                    raise ValueError("a message is implausibly large")
                if opcode == RecordType.CONNECTION:
                    read_bytes(data, size)
            if opcode != RecordType.MSGDATA:
                raise ValueError("the index points to something that is no message")
            return bytes(read_bytes(data, size if limit is None else min(size, limit)))

    def _load(self, position: int) -> FilePart | LazyChunk:
        chunk = self._reader.chunks[position]
        packed = FilePart(self._reader.bio, chunk.datapos, chunk.datasize)
        magic = packed.read(4)
        packed.seek(0)
        codec = next((name for begin, name in _MAGICS.items() if magic.startswith(begin)), "")
        return LazyChunk(packed, codec) if codec else packed


class SqliteStorage:
    """Messages of one `.db3` file; a position's offset is the row id.

    Parameters
    ----------
    reader : rosbags.rosbag2.storage_sqlite3.Sqlite3Reader
        Open; has the database.
    """

    def __init__(self, reader: Any) -> None:
        _check_whole(Path(reader.path))
        self.connections = reader.connections
        self._database = reader.dbconn

    def entries(self, channel: int) -> np.ndarray:
        """Positions of the messages of a topic."""
        query = "SELECT timestamp, 0, id FROM messages WHERE topic_id = ?"
        return table_of(self._database.execute(query, (channel,)).fetchall())

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of a message, or its first `limit` bytes (without reading the rest)."""
        with self._database.blob_open("main", "messages", "data", offset, False) as blob:
            size = blob.length()
            if size > MAX_SIZE:
                raise ValueError("a message is implausibly large")
            return bytes(blob.read(size if limit is None else min(limit, size)))


def _check_whole(path: Path) -> None:
    """SQLite itself notices a missing end only when it reads there."""
    with path.open("rb") as stream:
        header = stream.read(32)
    page_size, pages = struct.unpack_from(">H10xI", header, 16)
    if pages * (65_536 if page_size == 1 else page_size) > path.stat().st_size:
        raise ValueError("the file is truncated")
