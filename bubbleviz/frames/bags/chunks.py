"""Compressed chunks of a bag, decompressed only as far as they are read."""

from __future__ import annotations

import bz2
import sys
import zlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from lz4.frame import LZ4FrameDecompressor

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAX_SIZE = 1 << 30
"""No chunk or message of a sensor is larger, B; a file that says so is damaged."""

Read = Callable[[int, int], bytes]
"""Bytes of a file from an offset, exactly as many as asked for."""


def decompressor(codec: str) -> Any:
    """Incremental decompressor for `zstd`, `lz4` or `bz2`."""
    if codec == "zstd":
        return zstd.ZstdDecompressor()
    if codec == "lz4":
        return LZ4FrameDecompressor()
    if codec == "bz2":
        return bz2.BZ2Decompressor()
    raise ValueError(f"unknown compression {codec[:20]!r}")


def decompress(codec: str, data: bytes) -> bytes:
    """Decompress one whole block, refusing one that grows beyond any sensor's message."""
    out = decompressor(codec).decompress(data, MAX_SIZE)
    if len(out) >= MAX_SIZE:
        raise ValueError("a compressed message is implausibly large")
    return out


class LazyChunk:
    """A chunk that is read and decompressed only as far as asked for.

    Parameters
    ----------
    read : callable
        Reads (offset, count) bytes of the file.
    start, compressed_size : int
        Where the compressed bytes are.
    codec : str
        `zstd`, `lz4`, `bz2`; empty when nothing is compressed.
    size : int or None
        Decompressed size where the file tells.
    crc : int
        CRC-32 of the decompressed bytes, 0 for none; checked once all are there.
    """

    _FIRST_PIECE = 1 << 15  # enough for a header in most chunks

    def __init__(
        self,
        read: Read,
        start: int,
        compressed_size: int,
        codec: str,
        *,
        size: int | None = None,
        crc: int = 0,
    ) -> None:
        self._read, self._next, self._end = read, start, start + compressed_size
        self._start = start
        self._inflater: Any = decompressor(codec) if codec else None
        self._piece = self._FIRST_PIECE
        self._crc = crc
        self._out = bytearray()
        self._size = compressed_size if not codec else size
        if self._size is not None and self._size > MAX_SIZE:
            raise ValueError(f"a chunk of {self._size} bytes is implausibly large")

    @property
    def memory(self) -> int:
        """Bytes held."""
        return len(self._out)

    def slice(self, start: int, stop: int, *, short: bool = False) -> bytes:
        """Decompressed bytes start … stop; fewer at the chunk's end only when `short`."""
        if self._size is not None:
            stop = min(stop, self._size) if short else stop
            if not 0 <= start <= stop <= self._size:
                raise ValueError("a message lies outside its chunk")
        if stop > MAX_SIZE:
            raise ValueError("a message is implausibly large")
        if self._inflater is None:
            return self._read(self._start + start, stop - start)
        self._fill(stop, short)
        return bytes(memoryview(self._out)[start:stop])

    def _fill(self, stop: int, short: bool) -> None:
        if len(self._out) >= stop:
            return
        if self._size is not None and 2 * stop > self._size:
            stop = self._size  # most of it is wanted: take all, which also checks the CRC
        while len(self._out) < stop and not self._inflater.eof:
            piece = self._next_piece() if self._inflater.needs_input else b""
            got = self._inflater.decompress(piece, stop - len(self._out))
            self._out += got
            if not got and not piece and not self._inflater.eof:
                break
        if len(self._out) < stop and not short:
            raise ValueError("a compressed chunk ends early")
        if self._crc and len(self._out) == self._size:
            if zlib.crc32(self._out) != self._crc:
                raise ValueError("a chunk's checksum does not match")
            self._crc = 0

    def _next_piece(self) -> bytes:
        count = min(self._piece, self._end - self._next)
        piece = self._read(self._next, count) if count else b""
        self._next += count
        self._piece *= 4
        return piece


class ChunkCache:
    """The chunks used last: a frame and its neighbours, not the recording."""

    _MAX_CHUNKS = 8
    _MAX_MEMORY = 64 << 20

    def __init__(self, load: Callable[[int], LazyChunk]) -> None:
        self._load = load
        self._chunks: OrderedDict[int, LazyChunk] = OrderedDict()

    def __getitem__(self, number: int) -> LazyChunk:
        """Chunk `number`, from memory or from the file."""
        if number not in self._chunks:
            self._chunks[number] = self._load(number)
            self._evict()
        self._chunks.move_to_end(number)
        return self._chunks[number]

    def drop(self, number: int) -> None:
        """Forget a chunk that turned out to be damaged."""
        self._chunks.pop(number, None)

    def _evict(self) -> None:
        memory = sum(chunk.memory for chunk in self._chunks.values())
        while len(self._chunks) > 1 and (
            len(self._chunks) > self._MAX_CHUNKS or memory > self._MAX_MEMORY
        ):
            _, oldest = self._chunks.popitem(last=False)
            memory -= oldest.memory
