"""Random access to an MCAP file through its chunk and message indexes."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bubbleviz.frames.bags.chunks import MAX_SIZE, ChunkCache, LazyChunk
from bubbleviz.frames.bags.storage import Entries

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log, publish time
_MESSAGE_OP, _CHUNK_OP, _INDEX_OP = 0x05, 0x06, 0x07  # record types of the MCAP specification
_UNCHUNKED = -1  # in place of a chunk's number


class _ChunkPlace(NamedTuple):
    start: int
    index_offsets: dict[int, int]  # channel → offset of its message index; may be empty


class McapStorage:
    """Messages of one MCAP file by position.

    Files without a message index (or without chunks) are walked once, which decompresses them.

    Parameters
    ----------
    reader : rosbags.rosbag2.storage_mcap.McapReader
        Open; tells the chunks.
    """

    def __init__(self, reader: Any) -> None:
        path = Path(reader.path)
        self._file_size = path.stat().st_size
        self._file = path.open("rb")
        self._cache = ChunkCache(self._load)
        self._places = [
            _ChunkPlace(chunk.chunk_start_offset, chunk.message_index_offsets)
            for chunk in reader.chunks
        ]
        self._walked: dict[int, list[tuple[int, int, int]]] | None = None
        indexed = all(place.index_offsets for place in self._places)
        if not self._places or not indexed:
            self._walked = {}
            self._places = []
            self._walk(reader.data_start, reader.data_end)

    def entries(self, channel: int) -> Entries:
        """Positions of the messages of a channel, in file order."""
        if self._walked is not None:
            return Entries.of(self._walked.get(channel, []))
        numbers: list[int] = []
        blocks: list[bytes] = []
        for number, place in enumerate(self._places):
            if (offset := place.index_offsets.get(channel)) is not None:
                numbers.append(number)
                blocks.append(self._index(offset))
        pairs = np.frombuffer(b"".join(blocks), dtype="<i8").reshape(-1, 2)
        counts = np.array([len(block) // 16 for block in blocks], np.int64)
        chunk = np.repeat(np.array(numbers, np.int64), counts)
        return Entries(pairs[:, 0].astype(np.int64), chunk, pairs[:, 1].astype(np.int64))

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of a message, or its first `limit` bytes."""
        try:
            head = self._slice(chunk, offset, _MESSAGE.size + (limit or 0))
            opcode, length, *_ = _MESSAGE.unpack_from(head)
            size = length - (_MESSAGE.size - 9)  # the length counts from the channel id
            if opcode != _MESSAGE_OP or not 0 <= size <= MAX_SIZE:
                raise ValueError("the index points to something that is no message")
            if limit is not None:
                return head[_MESSAGE.size : _MESSAGE.size + min(size, limit)]
            start = offset + _MESSAGE.size
            payload = self._slice(chunk, start, size)
            if len(payload) != size:
                raise ValueError("a message is cut short")
            return payload
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

    def _slice(self, chunk: int, offset: int, count: int) -> bytes:
        if chunk == _UNCHUNKED:
            return self._bytes(offset, min(count, self._file_size - offset))
        return self._cache[chunk].slice(offset, offset + count, short=True)

    def _load(self, number: int) -> LazyChunk:
        start = self._places[number].start
        opcode, _, _, _, size, crc, name = struct.unpack("<BQQQQII", self._bytes(start, 41))
        if opcode != _CHUNK_OP or name > 32:
            raise ValueError("the index points to something that is no chunk")
        tail = self._bytes(start + 41, name + 8)
        (compressed,) = struct.unpack_from("<Q", tail, name)
        data = start + 41 + name + 8
        if data + compressed > self._file_size:
            raise ValueError("a chunk is cut short")
        codec = tail[:name].decode()
        return LazyChunk(self._bytes, data, compressed, codec, size=size, crc=crc)

    def _index(self, offset: int) -> bytes:
        """Pairs of log time and offset, 8 bytes each, from a MessageIndex record."""
        opcode, _, _, count = struct.unpack("<BQHI", self._bytes(offset, 15))
        if opcode != _INDEX_OP or count % 16:
            raise ValueError("a message index is damaged")
        return self._bytes(offset + 15, count)

    def _walk(self, start: int, stop: int) -> None:
        """Find chunks and messages where the file has no index of them."""
        offset = start
        while offset < stop:
            opcode, length = struct.unpack("<BQ", self._bytes(offset, 9))
            if opcode == _MESSAGE_OP:
                self._note(_UNCHUNKED, offset)
            elif opcode == _CHUNK_OP:
                self._places.append(_ChunkPlace(offset, {}))
                self._walk_chunk(len(self._places) - 1)
            offset += 9 + length

    def _walk_chunk(self, number: int) -> None:
        offset = 0
        while len(head := self._slice(number, offset, 9)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            if opcode == _MESSAGE_OP:
                self._note(number, offset)
            offset += 9 + length
            if offset > MAX_SIZE:
                raise ValueError("a record is implausibly large")

    def _note(self, chunk: int, offset: int) -> None:
        _, _, channel, _, log, _ = _MESSAGE.unpack(self._slice(chunk, offset, _MESSAGE.size))
        assert self._walked is not None
        self._walked.setdefault(channel, []).append((min(log, 2**63 - 1), chunk, offset))
