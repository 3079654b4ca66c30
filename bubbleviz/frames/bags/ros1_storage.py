"""Random access to a ROS 1 bag through its chunk index."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from bubbleviz.frames.bags.chunks import MAX_SIZE, ChunkCache, LazyChunk
from bubbleviz.frames.bags.storage import Entries

_MESSAGE_OP, _CONNECTION_OP = 2, 7  # record types of ROS 1 bags, version 2.0
_MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}  # no record can begin like these
_MAX_HEADER = 1 << 16  # B; ROS writes less than 1 kB


class Ros1Storage:
    """Messages of one ROS 1 bag; a position's chunk is where the chunk begins in the file.

    Parameters
    ----------
    reader : rosbags.rosbag1.Reader
        Open; tells the index.
    """

    def __init__(self, reader: Any) -> None:
        self._reader = reader
        self._file_size = Path(reader.path).stat().st_size
        self._file = Path(reader.path).open("rb")  # noqa: SIM115 (closed by close)
        self._cache = ChunkCache(self._load)

    def entries(self, channel: int) -> Entries:
        """Positions of the messages of a connection."""
        return Entries.of([tuple(entry) for entry in self._reader.indexes.get(channel, [])])

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of a message, or its first `limit` bytes."""
        try:
            data = self._cache[chunk]
            opcode = _CONNECTION_OP
            while opcode == _CONNECTION_OP:  # a message may follow its connection record
                opcode, start, size = self._record(data, offset)
                offset = start + size
            if opcode != _MESSAGE_OP:
                raise ValueError("the index points to something that is no message")
            return data.slice(start, start + (size if limit is None else min(size, limit)))
        except Exception:
            self._cache.drop(chunk)
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _bytes(self, offset: int, count: int) -> bytes:
        if not (offset >= 0 and count >= 0 and offset + count <= self._file_size):
            raise ValueError("an offset lies outside the file")
        self._file.seek(offset)
        data = self._file.read(count)
        if len(data) != count:
            raise ValueError("the file ends early")
        return data

    def _load(self, position: int) -> LazyChunk:
        chunk = self._reader.chunks[position]
        magic = self._bytes(chunk.datapos, min(4, chunk.datasize))
        codec = next((name for begin, name in _MAGICS.items() if magic.startswith(begin)), "")
        return LazyChunk(self._bytes, chunk.datapos, chunk.datasize, codec)

    @staticmethod
    def _record(data: LazyChunk, offset: int) -> tuple[int, int, int]:
        """Opcode, and start and size of the data, of the record at `offset` of a chunk."""
        (length,) = struct.unpack("<I", data.slice(offset, offset + 4))
        if length > _MAX_HEADER:
            raise ValueError("a record header is implausibly large")
        header = data.slice(offset + 4, offset + 4 + length + 4)
        (size,) = struct.unpack_from("<I", header, length)
        if size > MAX_SIZE:
            raise ValueError("a message is implausibly large")
        opcode, position = -1, 0
        while position < length:
            (field,) = struct.unpack_from("<I", header, position)
            name, _, value = header[position + 4 : position + 4 + field].partition(b"=")
            if name == b"op" and len(value) == 1:
                opcode = value[0]
            position += 4 + field
        return opcode, offset + 4 + length + 4, size
