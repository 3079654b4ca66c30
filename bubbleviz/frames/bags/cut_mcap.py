"""An MCAP file without its end: of a recorder that was killed, a full disk, or a copy cut short.

mcap is imported with the first such file: the window starts without it.
"""

from __future__ import annotations

import struct
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

MAGIC = b"\x89MCAP0\r\n"


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

    Reads the file once up to where it ends; decompresses only the chunks that bring a topic not
    seen before, or have no index. A last chunk whose indexes are missing is left out. Without
    chunks it is whole up to the last whole message.

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

    def open(self) -> None:
        """Scan the file."""
        from mcap.exceptions import McapError
        from mcap.records import Channel, Chunk, Message, MessageIndex, Schema
        from mcap.stream_reader import StreamReader, breakup_chunk

        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, str]] = {}
        counts: Counter[int] = Counter()
        chunk, start, end, indexed = None, 0, len(MAGIC), True
        with self.path.open("rb") as stream, suppress(McapError, struct.error):
            for record in StreamReader(stream, emit_chunks=True).records:
                inside = [record]
                if chunk is not None and not (indexed or isinstance(record, MessageIndex)):
                    inside = [*breakup_chunk(chunk, validate_crc=True), record]
                    self.chunks.append(CutChunk(start, {}))
                    self.data_end, indexed = end, True
                if isinstance(record, Chunk):
                    chunk, start, indexed = record, end, False
                elif isinstance(record, MessageIndex) and chunk is not None:
                    if not self.chunks or self.chunks[-1].chunk_start_offset != start:
                        self.chunks.append(CutChunk(start, {}))
                    self.chunks[-1].message_index_offsets[record.channel_id] = end
                    counts[record.channel_id] += len(record.records)
                    self.data_end, indexed = stream.tell(), True
                    if record.channel_id not in channels:
                        found = breakup_chunk(chunk, validate_crc=True)
                        inside = [each for each in found if not isinstance(each, Message)]
                elif isinstance(record, Message):
                    self.data_end = stream.tell()
                for each in inside:
                    if isinstance(each, Schema):
                        schemas[each.id] = each.name
                    elif isinstance(each, Channel):
                        channels[each.id] = each.topic, schemas.get(each.schema_id, "")
                    elif isinstance(each, Message):
                        counts[each.channel_id] += 1
                end = stream.tell()
        self.lost_bytes = self.path.stat().st_size - self.data_end
        self.connections = [
            CutConnection(channel, topic, kind, counts[channel])
            for channel, (topic, kind) in channels.items()
        ]

    def close(self) -> None:
        """Nothing is open."""
