"""An MCAP file without its end: what our recorder left behind when killed, or on a full disk."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

from bubbleviz.frames.bags.chunks import LazyChunk

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE = 0x02, 0x03, 0x04, 0x05
_CHUNK, _MESSAGE_INDEX, _DATA_END = 0x06, 0x07, 0x0F


OUR_LIBRARY = "bubbleviz"
"""What the header of a file names that our recorder wrote: chunk by chunk, each with its index."""


class CutConnection(NamedTuple):
    """A topic; names as rosbags' connections have them."""

    id: int
    topic: str
    msgtype: str
    msgcount: int


class CutChunk(NamedTuple):
    """A whole chunk; names as rosbags' chunks have them."""

    chunk_start_offset: int
    message_index_offsets: dict[int, int]


class CutMcapReader:
    """Finds what is whole in an MCAP file that ends early, as rosbags' reader does in others.

    Reads the message indexes behind the chunks and, of the chunks, only those that bring a topic
    not seen before. A last chunk whose indexes are missing is left out.

    Parameters
    ----------
    path : Path

    Attributes
    ----------
    connections : list of CutConnection
    chunks : list of CutChunk
    data_start, data_end : int
        Where whole records are.
    lost_bytes : int
        Bytes behind them.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[CutConnection] = []
        self.chunks: list[CutChunk] = []
        self.data_start = self.data_end = len(MAGIC)
        self.lost_bytes = 0
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self._counts: dict[int, int] = {}

    def open(self) -> None:
        """Scan the file."""
        size = self.path.stat().st_size
        with self.path.open("rb") as stream:
            self._scan(stream, size)
        self.lost_bytes = size - self.data_end
        self.connections = [
            CutConnection(channel, topic, kind, self._counts.get(channel, 0))
            for channel, (topic, kind) in self._channels.items()
        ]

    def close(self) -> None:
        """Nothing is open."""

    def _scan(self, stream: Any, size: int) -> None:
        offset = len(MAGIC)
        pending: list[tuple[int, int]] | None = None  # channel and index offset of the last chunk
        chunk = 0
        while offset + 9 <= size:
            stream.seek(offset)
            opcode, length = struct.unpack("<BQ", stream.read(9))
            if offset + 9 + length > size or opcode in (_DATA_END, _FOOTER):
                break
            if opcode == _MESSAGE_INDEX and pending is not None:
                pending.append((self._count(stream, length), offset))
            else:
                self._settle(chunk, pending, offset)
                pending = None
                if opcode == _CHUNK:
                    chunk, pending = offset, []
                elif opcode in (_SCHEMA, _CHANNEL):
                    self._describe(opcode, stream.read(length))
                elif opcode == _MESSAGE:
                    raise ValueError("it has no chunks, and no end")
            offset += 9 + length
        self._settle(chunk, pending, offset)
        self._name_topics(stream)

    def _count(self, stream: Any, length: int) -> int:
        channel, size = struct.unpack("<HI", stream.read(6))
        if size % 16 or size + 6 != length:
            raise ValueError("a message index is damaged")
        self._counts[channel] = self._counts.get(channel, 0) + size // 16
        return int(channel)

    def _settle(self, start: int, indexes: list[tuple[int, int]] | None, end: int) -> None:
        """Take a chunk with the indexes behind it."""
        if indexes:
            self.chunks.append(CutChunk(start, dict(indexes)))
            self.data_end = end

    def _name_topics(self, stream: Any) -> None:
        """Read the topics that chunks bring, from as few of them as possible."""

        def read(offset: int, count: int) -> bytes:
            stream.seek(offset)
            return bytes(stream.read(count))

        for place in self.chunks:
            if not place.message_index_offsets.keys() <= self._channels.keys():
                self._describe_chunk(read, place.chunk_start_offset)

    def _describe_chunk(self, read: Any, start: int) -> None:
        _, _, size, crc, name = struct.unpack("<QQQII", read(start + 9, 32))
        codec = read(start + 41, name).decode()
        (compressed,) = struct.unpack("<Q", read(start + 41 + name, 8))
        chunk = LazyChunk(read, start + 49 + name, compressed, codec, size=size, crc=crc)
        offset = 0
        while len(head := chunk.slice(offset, offset + 9, short=True)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            if opcode in (_SCHEMA, _CHANNEL):
                self._describe(opcode, chunk.slice(offset + 9, offset + 9 + length))
            offset += 9 + length

    def _describe(self, opcode: int, record: bytes) -> None:
        if opcode == _SCHEMA:
            (number,) = struct.unpack_from("<H", record)
            self._schemas[number] = _string(record, 2)
        else:
            number, schema = struct.unpack_from("<HH", record)
            self._channels[number] = (_string(record, 4), self._schemas.get(schema, ""))


def _string(record: bytes, offset: int) -> str:
    (length,) = struct.unpack_from("<I", record, offset)
    return record[offset + 4 : offset + 4 + length].decode()


def library_of(path: Path) -> str:
    """What wrote an MCAP file, by its header; empty where that cannot be read."""
    with path.open("rb") as stream:
        head = stream.read(4096)
    try:
        start = len(MAGIC) + 9
        (profile,) = struct.unpack_from("<I", head, start)
        return _string(head, start + 4 + profile)
    except (struct.error, UnicodeDecodeError):
        return ""
