"""Random access to a ROS 1 bag through its chunk index."""

from __future__ import annotations

from typing import Any

from bubbleviz.frames.bags.chunks import MAX_SIZE, ChunkCache, FilePart, LazyChunk
from bubbleviz.frames.bags.storage import Entries

_MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}  # no record can begin like these


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

    def entries(self, channel: int) -> Entries:
        """Positions of the messages of a connection."""
        return Entries.of([tuple(entry) for entry in self._reader.indexes.get(channel, [])])

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
