"""Interface of the bag storages: positions of messages, and their bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np


@dataclass(frozen=True)
class Entries:
    """Where the messages of one topic are.

    Attributes
    ----------
    log_ns : (n,) int64 array
        When each message was recorded, ns.
    chunk, offset : (n,) int64 array
        Position; what they mean is the storage's business.
    """

    log_ns: np.ndarray
    chunk: np.ndarray
    offset: np.ndarray

    @classmethod
    def of(cls, rows: np.ndarray | list[tuple[int, int, int]]) -> Entries:
        """Entries from rows of log time, chunk and offset."""
        table = np.asarray(rows, dtype=np.int64).reshape(-1, 3)
        return cls(table[:, 0].copy(), table[:, 1].copy(), table[:, 2].copy())


class Storage(Protocol):
    """One file of a bag. Anything it raises means the file is damaged.

    Attributes
    ----------
    connections : list
        With `id`, `topic`, `msgtype` and `msgcount`, as rosbags has them.
    """

    connections: list[Any]

    def entries(self, channel: int) -> Entries:
        """Positions of the messages of a channel (rosbags' connection id), in any order."""

    def read(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """Payload of the message at a position; only its first `limit` bytes when given."""
