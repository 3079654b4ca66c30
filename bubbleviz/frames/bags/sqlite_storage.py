"""Random access to a rosbag2 SQLite file by message id."""

from __future__ import annotations

import sqlite3
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
        Open; tells which file.
    """

    def __init__(self, reader: Any) -> None:
        path = Path(reader.path)
        _check_whole(path)
        uri = path.resolve().as_uri()
        # the worker that reads need not be the thread that opened; Recording has the lock
        self._database = sqlite3.connect(
            f"{uri}?mode=ro&immutable=1", uri=True, check_same_thread=False
        )

    def entries(self, channel: int) -> Entries:
        """Positions of the messages of a topic."""
        query = "SELECT timestamp, 0, id FROM messages WHERE topic_id = ?"
        return Entries.of(self._database.execute(query, (channel,)).fetchall())

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of a message, or its first `limit` bytes (without reading the rest)."""
        with self._database.blobopen("messages", "data", offset, readonly=True) as blob:
            if len(blob) > MAX_SIZE:
                raise ValueError("a message is implausibly large")
            return blob.read(-1 if limit is None else min(limit, len(blob)))

    def close(self) -> None:
        """Close the database."""
        self._database.close()


def _check_whole(path: Path) -> None:
    """SQLite itself notices a missing end only when it reads there."""
    with path.open("rb") as stream:
        header = stream.read(32)
    page_size, pages = struct.unpack_from(">H10xI", header, 16)
    if pages * (65_536 if page_size == 1 else page_size) > path.stat().st_size:
        raise ValueError("the file is truncated")
