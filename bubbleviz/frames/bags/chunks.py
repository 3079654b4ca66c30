"""Chunks of a bag as files, read and decompressed only as far as asked for.

The libraries' readers decompress a whole chunk for each message: to open a recording, which needs
sixteen bytes of each, would take as long as to read all of it.
"""

from __future__ import annotations

import bz2
import sys
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

from lz4.frame import LZ4FrameDecompressor

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAX_SIZE = 1 << 30
"""No chunk or message of a sensor is larger, B; a file that says so is damaged."""

_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": zstd.ZstdDecompressor,
    "lz4": LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
}
_FIRST_PIECE = 1 << 15  # B of a chunk to read for a header, which is enough in most


class FilePart:
    """Bytes `start` … `start + size` of a file that others read, too, as a file of its own."""

    memory = 0

    def __init__(self, file: BinaryIO | FilePart, start: int, size: int) -> None:
        self.size = size
        self._file, self._start, self._at = file, start, 0

    def seek(self, at: int) -> None:
        """Continue at a byte."""
        self._at = at

    def read(self, count: int) -> bytes:
        """As many bytes as asked for, fewer at the end."""
        self._file.seek(self._start + self._at)
        data = self._file.read(max(0, min(count, self.size - self._at)))
        self._at += len(data)
        return data


class LazyChunk:
    """A compressed chunk as a file.

    Parameters
    ----------
    packed : FilePart
        The compressed bytes.
    codec : {"zstd", "lz4", "bz2"}
    size : int
        Decompressed size, or more where the file does not tell.
    crc : int
        CRC-32 of the decompressed bytes, 0 for none; checked once all are there.
    """

    def __init__(self, packed: FilePart, codec: str, *, size: int = MAX_SIZE, crc: int = 0) -> None:
        if codec not in _DECOMPRESSORS:
            raise ValueError(f"unknown compression {codec[:20]!r}")
        if size > MAX_SIZE:
            raise ValueError(f"a chunk of {size} bytes is implausibly large")
        self.size = size
        self._packed, self._piece = packed, _FIRST_PIECE
        self._inflater = _DECOMPRESSORS[codec]()
        self._crc = crc
        self._out = bytearray()
        self._at = 0

    @property
    def memory(self) -> int:
        """Bytes held."""
        return len(self._out)

    def seek(self, at: int) -> None:
        """Continue at a byte."""
        self._at = at

    def read(self, count: int) -> bytes:
        """As many bytes as asked for, fewer at the end."""
        stop = min(self._at + count, self.size)
        if stop > len(self._out):
            # where most of it is wanted take all, which also checks the CRC
            self._fill(self.size if 2 * stop > self.size else stop)
        part = bytes(memoryview(self._out)[self._at : stop])
        self._at += len(part)
        return part

    def _fill(self, stop: int) -> None:
        while len(self._out) < stop and not self._inflater.eof:
            piece = self._packed.read(self._piece) if self._inflater.needs_input else b""
            self._piece *= 4 if piece else 1
            got = self._inflater.decompress(piece, stop - len(self._out))
            self._out += got
            if not (piece or got):  # cut short
                break
        if self._crc and len(self._out) == self.size and zlib.crc32(self._out) != self._crc:
            raise ValueError("a chunk's checksum does not match")


class ChunkCache:
    """The chunks used last: a frame and its neighbours, not the recording."""

    _MAX_CHUNKS = 8
    _MAX_MEMORY = 64 << 20

    def __init__(self, load: Callable[[int], FilePart | LazyChunk]) -> None:
        self._load = load
        self._chunks: OrderedDict[int, FilePart | LazyChunk] = OrderedDict()

    @contextmanager
    def at(self, number: int, offset: int) -> Iterator[FilePart | LazyChunk]:
        """Chunk `number` at an offset; forgotten if reading it fails, for it may be damaged."""
        if number not in self._chunks:
            self._chunks[number] = self._load(number)
            self._evict()
        self._chunks.move_to_end(number)
        try:
            self._chunks[number].seek(offset)
            yield self._chunks[number]
        except Exception:
            self._chunks.pop(number, None)
            raise

    def _evict(self) -> None:
        memory = sum(chunk.memory for chunk in self._chunks.values())
        while len(self._chunks) > 1 and (
            len(self._chunks) > self._MAX_CHUNKS or memory > self._MAX_MEMORY
        ):
            _, oldest = self._chunks.popitem(last=False)
            memory -= oldest.memory


def decompress(data: bytes) -> bytes:
    """Decompress one zstd message, refusing one that grows beyond any sensor's."""
    out = zstd.ZstdDecompressor().decompress(data, MAX_SIZE)
    if len(out) >= MAX_SIZE:
        raise ValueError("a compressed message is implausibly large")
    return out
