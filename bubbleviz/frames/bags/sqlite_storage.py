"""Random access to a rosbag2 SQLite file by message id."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from bubbleviz.frames.bags.chunks import MAX_SIZE
from bubbleviz.frames.bags.storage import Entries


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

    def entries(self, channel: int) -> Entries:
        """Positions of the messages of a topic."""
        query = "SELECT timestamp, 0, id FROM messages WHERE topic_id = ?"
        return Entries.of(self._database.execute(query, (channel,)).fetchall())

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
