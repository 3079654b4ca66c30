"""Random access to an MCAP file through its chunk and message indexes, or what is left of them."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from bubbleviz.frames.bags.chunks import MAX_SIZE, ChunkCache, FilePart, LazyChunk
from bubbleviz.frames.bags.storage import table_of

MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log, publish time
_SCHEMA_OP, _CHANNEL_OP, _MESSAGE_OP, _CHUNK_OP, _INDEX_OP = range(3, 8)
_UNCHUNKED = -1  # in place of a chunk's number


class _Connection(NamedTuple):
    """A topic; names as rosbags' connections have them."""

    id: int
    topic: str
    msgtype: str
    msgcount: int


class _ChunkPlace(NamedTuple):
    start: int
    index_offsets: dict[int, int]  # channel → offset of its message index; may be empty


class McapStorage:
    """Messages of one MCAP file by position.

    A file without its end (its recorder was killed, the disk was full) or without message indexes
    is walked record by record: that reads no chunk but those without an index or with new topics.

    Parameters
    ----------
    file : binary file
    reader : rosbags.rosbag2.storage_mcap.McapReader, optional
        Open; tells the chunks. None where the file has no end.

    Attributes
    ----------
    lost_bytes : int
        Bytes behind the last whole chunk of a file without its end.
    """

    def __init__(self, file: BinaryIO, reader: Any = None) -> None:
        self._file = FilePart(file, 0, os.fstat(file.fileno()).st_size)
        self._cache = ChunkCache(self._load)
        self._places: list[_ChunkPlace] = []
        self._found: dict[int, list[tuple[int, int, int]]] = {}  # messages without an index
        self.lost_bytes = 0
        chunks = [] if reader is None else reader.chunks
        if chunks and all(chunk.message_index_offsets for chunk in chunks):
            self._places = [
                _ChunkPlace(c.chunk_start_offset, c.message_index_offsets) for c in chunks
            ]
            self.connections: list[Any] = reader.connections
            return
        self._types: dict[int, str] = {}
        self._topics: dict[int, tuple[str, str]] = {}
        self._walk(reader.data_end if reader else self._file.size, cut=reader is None)
        self.connections = [
            _Connection(channel, topic, kind, len(self.entries(channel)))
            for channel, (topic, kind) in self._topics.items()
        ]

    def entries(self, channel: int) -> np.ndarray:
        """Positions of the messages of a channel, in file order where all have an index."""
        numbers: list[int] = []
        blocks: list[bytes] = []
        for number, place in enumerate(self._places):
            if (offset := place.index_offsets.get(channel)) is not None:
                numbers.append(number)
                blocks.append(self._index(offset))
        pairs = np.frombuffer(b"".join(blocks), dtype="<i8").reshape(-1, 2)
        counts = np.array([len(block) // 16 for block in blocks], np.int64)
        chunk = np.repeat(np.array(numbers, np.int64), counts)
        rows = np.column_stack([pairs[:, 0], chunk, pairs[:, 1]])
        return np.concatenate([rows, table_of(self._found.get(channel, []))])

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of a message, or its first `limit` bytes."""
        with self._cache.at(chunk, offset) as data:
            head = data.read(_MESSAGE.size + (limit or 0))
            opcode, length, *_ = _MESSAGE.unpack_from(head)
            size = length - (_MESSAGE.size - 9)  # the length counts from the channel id
            if opcode != _MESSAGE_OP or not 0 <= size <= MAX_SIZE:
                raise ValueError("the index points to something that is no message")
            if limit is not None:
                return head[_MESSAGE.size :][:size]
            payload = data.read(size)
            if len(payload) != size:
                raise ValueError("a message is cut short")
            return payload

    def _bytes(self, offset: int, count: int) -> bytes:
        self._file.seek(offset)
        data = self._file.read(count)
        if len(data) != count:
            raise ValueError("the file ends early")
        return data

    def _load(self, number: int) -> FilePart | LazyChunk:
        if number == _UNCHUNKED:
            return self._file
        start = self._places[number].start
        opcode, _, _, _, size, crc, name = struct.unpack("<BQQQQII", self._bytes(start, 41))
        if opcode != _CHUNK_OP or name > 32:
            raise ValueError("the index points to something that is no chunk")
        tail = self._bytes(start + 41, name + 8)
        (compressed,) = struct.unpack_from("<Q", tail, name)
        data = start + 41 + name + 8
        if data + compressed > self._file.size:
            raise ValueError("a chunk is cut short")
        packed, codec = FilePart(self._file, data, compressed), tail[:name].decode()
        return LazyChunk(packed, codec, size=size, crc=crc) if codec else packed

    def _index(self, offset: int) -> bytes:
        """Pairs of log time and offset, 8 bytes each, from a MessageIndex record."""
        opcode, _, _, count = struct.unpack("<BQHI", self._bytes(offset, 15))
        if opcode != _INDEX_OP or count % 16:
            raise ValueError("a message index is damaged")
        return self._bytes(offset + 15, count)

    def _walk(self, stop: int, *, cut: bool) -> None:
        """Find chunks, topics and messages where the file does not list them at its end."""
        walked = end = len(MAGIC)
        for opcode, at, length in _records(self._file, walked, stop):
            walked = at + 9 + length
            if opcode == _CHUNK_OP:
                self._places.append(_ChunkPlace(at, {}))
            elif opcode == _INDEX_OP and self._places:
                (channel,) = struct.unpack("<H", self._bytes(at + 9, 2))
                self._places[-1].index_offsets[channel] = at
            else:
                self._note(self._file, _UNCHUNKED, opcode, at)
            if opcode in (_MESSAGE_OP, _CHUNK_OP, _INDEX_OP):
                end = walked
        if not cut and walked != stop:
            raise ValueError("a record is cut short")
        if cut and self._places:  # its last chunk may lack some indexes
            self._places[-1].index_offsets.clear()
        for number, (start, indexes) in enumerate(self._places):
            if indexes and indexes.keys() <= self._topics.keys():
                continue
            try:
                self._walk_chunk(number, messages=not indexes)
            except Exception:
                if not cut or number < len(self._places) - 1:
                    raise
                self._places.pop()  # a file can have room for a chunk before it has the chunk
                end = start
        self.lost_bytes = self._file.size - end if cut else 0

    def _walk_chunk(self, number: int, *, messages: bool) -> None:
        with self._cache.at(number, 0) as data:
            if len(data.read(data.size)) != data.size:
                raise ValueError("a chunk is cut short")
            for opcode, at, _ in _records(data, 0, data.size):
                if messages or opcode != _MESSAGE_OP:
                    self._note(data, number, opcode, at)

    def _note(self, data: FilePart | LazyChunk, number: int, opcode: int, at: int) -> None:
        """Take note of what a record says of topics and messages."""
        from mcap.data_stream import ReadDataStream  # only for files without an index
        from mcap.records import Channel, Schema

        stream: Any = data
        if opcode == _SCHEMA_OP:
            data.seek(at + 9)
            schema = Schema.read(ReadDataStream(stream))
            self._types[schema.id] = schema.name
        elif opcode == _CHANNEL_OP:
            data.seek(at + 9)
            channel = Channel.read(ReadDataStream(stream))
            self._topics[channel.id] = channel.topic, self._types.get(channel.schema_id, "")
        elif opcode == _MESSAGE_OP:
            data.seek(at)
            _, _, to, _, log, _ = _MESSAGE.unpack(data.read(_MESSAGE.size))
            self._found.setdefault(to, []).append((min(log, 2**63 - 1), number, at))


def _records(data: FilePart | LazyChunk, at: int, stop: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of the records that are whole, up to the first that is not."""
    while True:
        data.seek(at)
        head = data.read(9)
        opcode, length = struct.unpack("<BQ", head) if len(head) == 9 else (0, 0)
        if not opcode or at + 9 + length > stop:
            return
        yield opcode, at, length
        at += 9 + length
