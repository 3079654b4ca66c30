"""Random access to messages in ROS 1, SQLite and MCAP files."""

from __future__ import annotations

import bz2
import os
import shutil
import struct
import sys
import tempfile
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Protocol

import numpy as np
from lz4.frame import LZ4FrameDecompressor

from bubbleviz.errors import InputError

# Chunks of a bag as files, read and decompressed only up to the requested byte.
#
# The libraries' readers decompress a whole chunk for each message: opening a recording, which needs
# 16 bytes of each message, would take as long as reading all of it.


if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAX_SIZE = 1 << 28  # no chunk or message of a sensor is larger, B: 8192×8192 pixels of 4 bytes

_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}
_FIRST_PIECE = 1 << 15  # B of a chunk to read for a header, which is enough in most


class FilePart:
    """Bytes `start` … `start + size` of a shared file, as a file of its own."""

    memory = 0

    def __init__(self, file: BinaryIO | FilePart, start: int, size: int) -> None:
        self.size = size
        self._file, self._start, self._at = file, start, 0

    def seek(self, at: int) -> None:
        self._at = at

    def read(self, count: int) -> bytes:
        self._file.seek(self._start + self._at)
        data = self._file.read(max(0, min(count, self.size - self._at)))
        self._at += len(data)
        return data


class LazyChunk:
    def __init__(
        self,
        packed: FilePart,  # the compressed bytes
        codec: str,
        *,
        size: int = MAX_SIZE,  # decompressed size, or an upper limit if the file has none
        crc: int = 0,  # CRC-32 of the decompressed bytes, 0 for none; checked once all are there
    ) -> None:
        if codec not in _DECOMPRESSORS:
            known = ", ".join(_DECOMPRESSORS)
            raise ValueError(f"compression {codec[:20]!r} is not one of {known}")
        if size > MAX_SIZE:
            raise ValueError(
                f"a chunk of {size} bytes is above the limit of {MAX_SIZE} bytes: it is damaged, "
                "or was recorded with too large a chunk size"
            )
        self.size = size
        self._packed, self._piece = packed, _FIRST_PIECE
        self._inflater: Any = _DECOMPRESSORS[codec]()  # None: all is there
        self._crc = crc
        self._out = bytearray()
        self._at = 0

    @property
    def memory(self) -> int:
        return len(self._out)

    def seek(self, at: int) -> None:
        self._at = at

    def read(self, count: int) -> bytes:
        stop = min(self._at + count, self.size)
        if stop > len(self._out):
            # if most of it is needed read all, which also checks the CRC
            self._fill(self.size if 2 * stop > self.size else stop)
        part = bytes(memoryview(self._out)[self._at : stop])
        self._at += len(part)
        return part

    def _fill(self, stop: int) -> None:
        while self._inflater is not None and len(self._out) < stop:
            piece = self._packed.read(self._piece) if self._inflater.needs_input else b""
            self._piece *= 4 if piece else 1
            got = self._inflater.decompress(piece, stop - len(self._out))
            self._out += got
            if self._inflater.eof or len(self._out) == self.size or not (piece or got):  # cut short
                self._inflater = None  # that of zstd keeps as much as the chunk
        if self._crc and len(self._out) == self.size and zlib.crc32(self._out) != self._crc:
            raise ValueError("a chunk's checksum does not match")


class ChunkCache:
    """The chunks used last: enough for a frame and its neighbours."""

    _MAX_CHUNKS = 8
    _MAX_MEMORY = 64 << 20

    def __init__(self, load: Callable[[int], FilePart | LazyChunk]) -> None:
        self._load = load
        self._chunks: OrderedDict[int, FilePart | LazyChunk] = OrderedDict()

    @contextmanager
    def at(self, number: int, offset: int) -> Iterator[FilePart | LazyChunk]:
        """Chunk `number` at an offset; dropped from the cache if reading fails."""
        if number not in self._chunks:
            self._chunks[number] = self._load(number)
            memory = sum(chunk.memory for chunk in self._chunks.values())
            while len(self._chunks) > 1 and (
                len(self._chunks) > self._MAX_CHUNKS or memory > self._MAX_MEMORY
            ):
                _, oldest = self._chunks.popitem(last=False)
                memory -= oldest.memory
        self._chunks.move_to_end(number)
        try:
            self._chunks[number].seek(offset)
            yield self._chunks[number]
        except Exception:
            self._chunks.pop(number, None)
            raise


def decompress(data: bytes) -> bytes:
    """Decompress one zstd message, refusing one larger than any sensor sends."""
    if (zstd.get_frame_info(data).decompressed_size or 0) < MAX_SIZE:
        out = zstd.ZstdDecompressor().decompress(data, MAX_SIZE)
        if len(out) < MAX_SIZE:
            return out
    raise ValueError(f"a message decompresses to {MAX_SIZE} bytes or more, which is not plausible")


def check_unpacked(folder: Path) -> None:
    """Refuse compressed files that would fill the disk when unpacked."""
    left = shutil.disk_usage(tempfile.gettempdir()).free // 2
    for file in folder.glob("*.zstd"):
        with zstd.open(file, "rb") as unpacked:
            while piece := unpacked.read(1 << 20):
                left -= len(piece)
                if left < 0:
                    raise InputError(
                        f"{folder}: its files would fill more than half of the free disk space "
                        f"when unpacked; free space in {tempfile.gettempdir()}, or set TMPDIR to a "
                        "folder on a larger disk"
                    )


_MAGICS = {b"\x04\x22\x4d\x18": "lz4", b"BZh": "bz2"}  # no record can begin like these


class Storage(Protocol):
    """One file of a bag; every exception of its methods means that the file is damaged.

    Attributes
    ----------
    connections : list
        With `id`, `topic`, `msgtype` and `msgcount`, as rosbags has them.
    """

    connections: list[Any]

    def entries(self, channel: int) -> np.ndarray:
        """Log time in ns and position of the messages of a channel, in any order, (n, 3) int64.

        A position is a chunk and an offset, as this storage defines them.
        """

    def read(self, chunk: int, offset: int, limit: int | None = None) -> tuple[bytes, int]:
        """Payload of the message at a position, and its size; its first `limit` bytes if given."""


def table_of(rows: Any) -> np.ndarray:
    """Rows of three integers as an array (n, 3); n may be 0."""
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


class Ros1Storage:
    """Messages of one ROS 1 bag; a position's chunk is its offset in the file."""

    def __init__(
        self,
        reader: Any,  # open; has the index
    ) -> None:
        self.connections = reader.connections
        self._reader = reader
        self._cache = ChunkCache(self._load)

    def entries(self, channel: int) -> np.ndarray:
        return table_of([tuple(entry) for entry in self._reader.indexes.get(channel, [])])

    def read(self, chunk: int, offset: int, limit: int | None = None) -> tuple[bytes, int]:
        # imported by the reader already
        from rosbags.rosbag1.reader import Header, RecordType, read_bytes, read_uint32

        with self._cache.at(chunk, offset) as data:
            opcode = RecordType.CONNECTION
            while opcode == RecordType.CONNECTION:  # a message may follow its connection record
                opcode = Header.read(data).get_uint8("op")
                size = read_uint32(data)
                if size > MAX_SIZE:
                    raise ValueError(f"a message of {size} bytes is not plausible")
                if opcode == RecordType.CONNECTION:
                    read_bytes(data, size)
            if opcode != RecordType.MSGDATA:
                raise ValueError("the index does not point to a message")
            return bytes(read_bytes(data, size if limit is None else min(size, limit))), size

    def _load(self, position: int) -> FilePart | LazyChunk:
        chunk = self._reader.chunks[position]
        packed = FilePart(self._reader.bio, chunk.datapos, chunk.datasize)
        magic = packed.read(4)
        packed.seek(0)
        codec = next((name for begin, name in _MAGICS.items() if magic.startswith(begin)), "")
        return LazyChunk(packed, codec) if codec else packed


class SqliteStorage:
    """Messages of one `.db3` file; a position's offset is the row id."""

    def __init__(
        self,
        reader: Any,  # open; has the database
    ) -> None:
        _check_whole(Path(reader.path))
        self.connections = reader.connections
        self._database = reader.dbconn

    def entries(self, channel: int) -> np.ndarray:
        query = "SELECT timestamp, 0, id FROM messages WHERE topic_id = ?"
        return table_of(self._database.execute(query, (channel,)).fetchall())

    def read(self, chunk: int, offset: int, limit: int | None = None) -> tuple[bytes, int]:
        with self._database.blob_open("main", "messages", "data", offset, False) as blob:
            size = blob.length()
            if size > MAX_SIZE:
                raise ValueError(f"a message of {size} bytes is not plausible")
            return bytes(blob.read(size if limit is None else min(limit, size))), size


def _check_whole(path: Path) -> None:
    """Raise if the file is cut short, which SQLite notices only when it reads beyond the end."""
    with path.open("rb") as stream:
        header = stream.read(32)
    page_size, pages = struct.unpack_from(">H10xI", header, 16)
    if pages * (65_536 if page_size == 1 else page_size) > path.stat().st_size:
        raise ValueError("the file is truncated")


# Random access to an MCAP file through its chunk and message indexes, even if incomplete.


MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log, publish time
_SCHEMA_OP, _CHANNEL_OP, _MESSAGE_OP, _CHUNK_OP, _INDEX_OP = range(3, 8)
_DATA_END_OP, _DATA_END_LENGTH = 15, 4
_UNCHUNKED = -1  # chunk number of messages outside chunks
_MAX_MESSAGES = 10_000_000  # of a topic in a file without an index: four days at 30 Hz


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

    A truncated file (its recorder was killed, the disk was full) or one without message indexes is
    scanned record by record, reading only the chunks without an index or with new topics.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._name, self._file = file.name, FilePart(file, 0, os.fstat(file.fileno()).st_size)
        self._cache = ChunkCache(self._load)
        self._places: list[_ChunkPlace] = []
        # rows of `entries` by channel, one after the other, of messages without an index
        self._found: dict[int, array[int]] = {}
        self._types: dict[int, str] = {}
        self._topics: dict[int, tuple[str, str]] = {}
        size = self._file.size
        if size == 0 or self._bytes(0, 8) != MAGIC:
            raise ValueError("it is not an MCAP file" if size else "the file is empty")
        self.is_cut = size < 16 or self._bytes(size - 8, 8) != MAGIC  # whether it has no end
        self.lost_bytes = 0  # bytes behind the last whole chunk of such a file
        counts: dict[int, int] = {}
        if self.is_cut or not self._take_summary(file, counts):
            self._walk(size if self.is_cut else size - 8)
        self.connections: list[Any] = [
            _Connection(channel, *names, counts.get(channel) or len(self.entries(channel)))
            for channel, names in self._topics.items()
        ]

    def _take_summary(self, file: BinaryIO, counts: dict[int, int]) -> bool:
        """Read chunks, topics and counts from the end of a file; returns whether all are there."""
        from mcap.reader import SeekingReader  # loaded with the first MCAP file

        file.seek(0)  # the library checks the magic bytes at the start
        try:
            summary = SeekingReader(file, record_size_limit=MAX_SIZE).get_summary()
        except (OSError, MemoryError):
            raise
        except Exception:  # damaged
            summary = None
        chunks = [] if summary is None else summary.chunk_indexes
        if summary is None or not (chunks and all(c.message_index_offsets for c in chunks)):
            return False
        self._places = [_ChunkPlace(c.chunk_start_offset, c.message_index_offsets) for c in chunks]
        for channel in summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            self._topics[channel.id] = channel.topic, schema.name if schema else ""
        if summary.statistics is not None:
            counts.update(summary.statistics.channel_message_counts)
        return True

    def entries(self, channel: int) -> np.ndarray:
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

    def read(self, chunk: int, offset: int, limit: int | None = None) -> tuple[bytes, int]:
        with self._cache.at(chunk, offset) as data:
            head = data.read(_MESSAGE.size + (limit or 0))
            opcode, length, *_ = _MESSAGE.unpack_from(head)
            size = length - (_MESSAGE.size - 9)  # the length counts from the channel id
            if opcode != _MESSAGE_OP or not 0 <= size <= MAX_SIZE:
                raise ValueError("the index does not point to a message of plausible size")
            if limit is not None:
                return head[_MESSAGE.size :][:size], size
            payload = data.read(size)
            if len(payload) != size:
                raise ValueError("a message is cut short")
            return payload, size

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
            raise ValueError("the index does not point to a chunk")
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

    def _walk(self, stop: int) -> None:
        """Scan for chunks, topics and messages if the file does not list them at its end."""
        walked, end, cut = len(MAGIC), len(MAGIC), self.is_cut
        for opcode, at, length in _records(self._file, walked, stop):
            walked = at + 9 + length
            if opcode == _DATA_END_OP and length == _DATA_END_LENGTH:  # the summary follows
                walked = stop
                break
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
            raise ValueError("a record is damaged or cut short")
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
                self._places.pop()  # the file can be longer than the data written so far
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
        """Collect topics and messages from a record."""
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
            rows = self._found.setdefault(to, array("q"))
            rows.extend((min(log, 2**63 - 1), number, at))
            if len(rows) > 3 * _MAX_MESSAGES:
                raise InputError(
                    f"{self._name}: a topic has more than {_MAX_MESSAGES:,} messages that no index "
                    "lists; run mcap recover on this file and open the copy"
                )


def _records(data: FilePart | LazyChunk, at: int, stop: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of the records before the first incomplete one."""
    while True:
        data.seek(at)
        head = data.read(9)
        opcode, length = struct.unpack("<BQ", head) if len(head) == 9 else (0, 0)
        if not opcode or at + 9 + length > stop:
            return
        yield opcode, at, length
        at += 9 + length
