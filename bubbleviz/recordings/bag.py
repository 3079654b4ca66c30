"""Open a recording in any file format, and read the messages of its topics.

rosbags is imported with the first recording: the window starts without it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.files import as_input_error, exists
from bubbleviz.recordings.bag_storage import (
    McapStorage,
    Ros1Storage,
    SqliteStorage,
    Storage,
    check_unpacked,
    decompress,
    table_of,
)
from bubbleviz.recordings.message_decoding import MAX_STAMP_NS, begins_as_cdr, header_stamp_ns

UNREADABLE = -1  # instead of the stamp, for a message without a header
_PART_GAP_NS = -100_000_000, 2_000_000_000
"""Least and most time from the end of a file to the start of the next in one recording: topics may
overlap by 0.1 s, and a recorder needs less than 2 s to open a file; chosen."""
MAX_UNREADABLE = 100  # most messages at the start of a topic to search for a readable one


@dataclass(frozen=True)
class Topic:
    # name, type: as in ROS 2: `/depth/image`, `sensor_msgs/msg/Image`
    name: str
    type: str
    count: int  # number of messages


@cache
def typestore(*, ros1: bool) -> Any:
    """Message types by name; they compile their readers once, hence the cache."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    # the types used here are the same in every ROS 2 so far
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:  # the one type used here that is not in rosbags' list
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    return store


class Bag:
    """An open rosbag2 folder, `.mcap`, `.db3` or ROS 1 `.bag`."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.note = ""  # missing parts of the recording, as text; empty if it is complete
        self._storages: list[Storage] = []
        self._open_files = ExitStack()
        if not exists(self.path):
            raise InputError(
                f"{self.path}: no such recording, or no access to it; check path and permissions"
            )
        # whether messages are serialised as in ROS 1
        self.ros1 = self.path.suffix.lower() == ".bag"
        try:
            with as_input_error(self.path, "the recording"):
                self._open()
        except BaseException:
            self.close()
            raise
        if not any(topic.count for topic in self.topics):
            self.close()
            raise InputError(
                f"{self.path}: the recording ends before its first message; copy it again if the "
                "original is complete, else record again"
                if self.note
                else f"{self.path}: the recording has no messages; record again while the depth "
                "camera publishes"
            )

    def close(self) -> None:
        self._storages = []
        self._open_files.close()

    def messages(self, topic: Topic) -> Messages:
        """Messages of a topic in the order of their log times."""
        with as_input_error(self.path, f"the index of {topic.name}"):
            parts = [
                (storage, storage.entries(connection.id))
                for storage in self._storages
                for connection in storage.connections
                if (connection.topic, connection.msgtype) == (topic.name, topic.type)
            ]
            return Messages(self, topic, parts)

    def _open(self) -> None:
        # whether each message is compressed, so that its first bytes need all of it
        self.inflates = False
        has_metadata = (self.path / "metadata.yaml").exists()  # which names the files
        if self.ros1:
            from rosbags.rosbag1 import Reader

            self._storages = [Ros1Storage(self._opened(Reader(self.path)))]
        else:
            parts = self._ros2_files(has_metadata=has_metadata)
            self._storages = [self._ros2_file(file) for file in parts]
            if len(parts) > 1 and not has_metadata and not _are_consecutive(self._storages):
                raise InputError(
                    f"{self.path}: contains {len(parts)} recordings ({parts[0].name}, "
                    f"{parts[1].name} …) that do not follow each other; give one of the files, "
                    "estimate each (bubbleviz batch), or join parts of one (ros2 bag reindex)"
                )
        counts: Counter[tuple[str, str]] = Counter()
        for connection in (each for storage in self._storages for each in storage.connections):
            counts[str(connection.topic), str(connection.msgtype)] += int(connection.msgcount)
        # in the order of the recording
        self.topics = tuple(Topic(name, kind, count) for (name, kind), count in counts.items())
        files = [self.path] if self.path.is_file() else self.path.iterdir()
        # size of the recording's files
        self.size_bytes = sum(file.stat().st_size for file in files if file.is_file())

    def _ros2_file(self, file: Path) -> Storage:
        if file.suffix.lower() == ".db3":
            from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

            return SqliteStorage(self._opened(Sqlite3Reader(file)))
        if file.suffix.lower() != ".mcap":
            raise InputError(
                f"{file}: not a recording by its suffix; give a rosbag2 folder, or a .mcap, .db3 "
                "or .bag file"
            )
        storage = McapStorage(self._open_files.enter_context(file.open("rb")))
        if storage.is_cut:
            lost = f"; {storage.lost_bytes / 1e3:.3g} kB after it are lost"
            self.note = self.note or (
                f"{file.name} ends early, as after an interrupted recording or copy: read up to "
                f"its last complete chunk or message{lost if storage.lost_bytes else ''}; copy it "
                "again if the original is complete"
            )
        return storage

    def _opened(self, reader: Any) -> Any:
        """Open a reader of rosbags; it is closed with the bag."""
        reader.open()
        self._open_files.callback(reader.close)
        return reader

    def _ros2_files(self, *, has_metadata: bool) -> list[Path]:
        if self.path.is_file():
            return [self.path]
        if has_metadata:
            check_unpacked(self.path)
            folder = self._opened(_folder_reader()(self.path))
            self.inflates = folder.metadata.compression_mode == "message"
            return [each.path for each in folder.storages]
        files = sorted(f for f in self.path.iterdir() if f.suffix.lower() in (".mcap", ".db3"))
        if not files:
            raise InputError(
                f"{self.path}: no recording in this folder; give a folder with .mcap or .db3 "
                "files, a .bag file itself, or convert a folder of depth images first (bubbleviz "
                "convert)"
            )
        return files


def _are_consecutive(storages: list[Storage]) -> bool:
    """Whether files follow each other in time, as those of a recorder that splits a recording."""
    ranges = []
    for storage in storages:
        rows = [storage.entries(connection.id) for connection in storage.connections]
        times_ns = np.concatenate([table_of([]), *rows])[:, 0]
        if len(times_ns):  # an interrupted recorder may have just begun the last one
            ranges.append((int(times_ns.min()), int(times_ns.max())))
    least, most = _PART_GAP_NS
    return all(
        before[0] < after[0] and least <= after[0] - before[1] <= most
        for before, after in pairwise(sorted(ranges))
    )


@cache
def _folder_reader() -> Any:
    """Folder reader of rosbags: reads the metadata and decompresses compressed files."""
    from rosbags.rosbag2.reader import DirectoryReader

    class NamedFile:
        """A file of the folder, not opened by rosbags."""

        connections: ClassVar[list[Any]] = []

        def __init__(self, path: Path) -> None:
            self.path = path

        def open(self) -> None: ...
        def close(self) -> None: ...

    class FolderReader(DirectoryReader):  # type: ignore[misc]
        STORAGE_PLUGINS: ClassVar[Any] = {"mcap": NamedFile, "sqlite3": NamedFile}

    return FolderReader


class Messages:
    """Messages of one topic by index in log-time order, without a cache."""

    def __init__(self, bag: Bag, topic: Topic, parts: list[tuple[Storage, np.ndarray]]) -> None:
        self.topic = topic
        self._bag = bag
        self._storages = [storage for storage, _ in parts]
        numbered = [np.insert(rows, 3, part, axis=1) for part, (_, rows) in enumerate(parts)]
        rows = np.concatenate(numbered or [np.empty((0, 4), np.int64)])
        rows[:, 0] = rows[:, 0].clip(0, MAX_STAMP_NS)
        self._rows = rows[np.argsort(rows[:, 0], kind="stable")]
        self.log_ns = self._rows[:, 0].copy()  # (n,) int64, when each message was recorded, ns

    def __len__(self) -> int:
        return len(self.log_ns)

    def payload(self, k: int) -> bytes:
        """Serialised message `k`."""
        return self._read(k, None)[0]

    def header(self, k: int) -> tuple[int, int]:
        """Header stamp of message `k`, ns, and its size; reads no more than the header.

        The stamp is 0 when unset, `UNREADABLE` where the message has none.
        """
        with as_input_error(self._bag.path, f"the header of message {k} of {self.topic.name}"):
            begin, size = self._read(k, 16)
            if len(begin) < 12 or not (self._bag.ros1 or begins_as_cdr(begin)):
                return UNREADABLE, size
            return header_stamp_ns(begin, ros1=self._bag.ros1), size

    def stamp_ns(self, k: int) -> int:
        """Header stamp of message `k`, ns; 0 when unset, its log time where it has no header."""
        stamp, _ = self.header(k)
        return int(self.log_ns[k]) if stamp == UNREADABLE else stamp

    def first(self, wanted: Callable[[Any], bool] = lambda _: True) -> Any:
        """The first readable message that satisfies a condition; else message 0, or its error."""
        for k in range(min(len(self), MAX_UNREADABLE)):
            with suppress(InputError):
                message = self.message(k)
                if wanted(message):
                    return message
        return self.message(0)

    def message(self, k: int) -> Any:
        """Message `k`, decoded by rosbags."""
        with as_input_error(self._bag.path, f"message {k} of {self.topic.name}"):
            store = typestore(ros1=self._bag.ros1)
            read = store.deserialize_ros1 if self._bag.ros1 else store.deserialize_cdr
            return read(self.payload(k), self.topic.type)

    def _read(self, k: int, limit: int | None) -> tuple[bytes, int]:
        _, chunk, offset, part = self._rows[k].tolist()
        if not self._bag.inflates:
            return self._storages[part].read(chunk, offset, limit)
        whole = decompress(self._storages[part].read(chunk, offset)[0])
        return whole[:limit], len(whole)
