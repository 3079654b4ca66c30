"""Records every message of one or more sources; skips none."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bubbleviz.errors import InputError
from bubbleviz.files import refuse_existing
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.recordings import (
    MARKERS,
    STRING,
    Flushed,
    McapFile,
    Message,
    are_static_poses,
    ros2_types,
    serialise,
)
from bubbleviz.wording import count_of

SYNC_S = 0.4  # interval of fsync, s: the most that a crash can lose
FLUSH_BYTES = 1 << 20
"""Messages buffered before a flush: the most that a full disk can lose."""
QUEUE_BYTES = 256 << 20  # most that may wait for the disk; beyond it the source waits
PRE_ROLL_BYTES = 256 << 20  # memory for messages before recording starts; chosen

STATIC_BYTES = 1 << 20  # of static poses, the latest ones: some 10,000 links


@dataclass(frozen=True)
class RecorderStatus:
    path: Path
    messages: int  # messages written
    waiting_bytes: int  # of messages that wait for the disk
    size_bytes: int  # of the part of the file that survives a crash
    problem: str  # text: why recording ended early; else empty


class Recorder:
    """Keeps the last seconds of messages as pre-roll, and writes a recording when started."""

    def __init__(
        self,
        pre_roll_s: float = 0.0,  # seconds before `start` that are recorded, too
    ) -> None:
        self.pre_roll_s = pre_roll_s
        self._before: deque[Message] = deque()
        self._before_bytes = 0
        self._static: dict[bytes, Message] = {}
        self._session: _Session | None = None
        self._streams: list[LiveStream] = []
        self._unfollow_colour: list[Callable[[], None]] = []
        self._lock = threading.Lock()

    def listen_to(self, stream: LiveStream) -> None:
        """Record every message of a stream; it sends colour images while it is recorded."""
        self._streams.append(stream)
        stream.listen(self.push)
        if self.recording:
            self._unfollow_colour.append(stream.follow_colour())

    @property
    def recording(self) -> bool:
        return self._session is not None

    def push(self, message: Message) -> None:
        """Record a message, or keep it as pre-roll. Thread-safe; waits only for a slow disk.

        Messages of unknown types, which the file cannot describe, are ignored.
        """
        if message.type not in ros2_types().fielddefs:
            return
        with self._lock:
            if are_static_poses(message.topic, message.type):
                # sent only once, but needed in every recording
                self._static.pop(message.payload, None)
                self._static[message.payload] = message
                while sum(map(len, self._static)) > STATIC_BYTES:
                    del self._static[next(iter(self._static))]
            session = self._session
            if session is None:
                self._keep(message)
                return
        session.put(message)

    def start(self, path: str | Path, *, replaces: bool = False) -> None:
        """Begin to write, with the pre-roll: the file is made when the first message arrives.

        `replaces`: if writing fails, an earlier recording is restored in its place.

        Raises InputError: the path exists or cannot be written, or a recording is in progress.
        """
        with self._lock:
            if self._session is not None:
                raise InputError(f"{path}: a recording is already in progress; stop it first")
            refuse_existing(path, ".mcap", "")
            session = _Session(Path(path), tuple(self._static.values()), replaces)
            for message in self._before:
                session.put(message)
            self._before.clear()
            self._before_bytes = 0
            self._session = session
        self._unfollow_colour = [stream.follow_colour() for stream in self._streams]

    def mark(self, text: str = "marker", at_ns: int | None = None) -> None:
        """Write a marker or note into the recording, at a time (ns since 1970), by default now."""
        content = ros2_types().types[STRING](data=text)
        when = time.time_ns() if at_ns is None else at_ns
        self.push(Message(MARKERS, STRING, serialise(content, STRING), 0, when))

    def status(self) -> RecorderStatus | None:
        """State of the current recording; None without one."""
        session = self._session
        return None if session is None else session.status()

    def stop(self) -> RecorderStatus:
        """End the recording and return its final state. A recording without messages is deleted."""
        with self._lock:
            session, self._session = self._session, None
        if session is None:
            raise InputError("no recording is in progress; start one first")
        for unfollow in self._unfollow_colour:
            unfollow()
        session.finish()
        return session.status()

    def _keep(self, message: Message) -> None:
        if self.pre_roll_s <= 0.0:
            return
        self._before.append(message)
        self._before_bytes += len(message.payload)
        oldest = message.arrival_ns - round(self.pre_roll_s * 1e9)
        while self._before[0].arrival_ns < oldest or self._before_bytes > PRE_ROLL_BYTES:
            self._before_bytes -= len(self._before.popleft().payload)


class _Session:
    """One recording: a queue, and a thread that writes it.

    The static poses get the log time of the first message.
    """

    def __init__(self, path: Path, static: tuple[Message, ...], replaces: bool) -> None:
        self._path, self._replaces = path, replaces
        self._file: McapFile | None = None
        self._queue: deque[Message] = deque()
        self._static = static
        self._bytes = sum(len(message.payload) for message in static)
        self._ending = False
        self._problem = ""
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, message: Message) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._bytes <= QUEUE_BYTES or bool(self._problem))
            if self._problem:
                return
            self._queue.append(message)
            self._bytes += len(message.payload)
            self._changed.notify_all()

    def finish(self) -> None:
        with self._changed:
            self._ending = True
            self._changed.notify_all()
        self._thread.join()

    def status(self) -> RecorderStatus:
        with self._changed:
            file = self._file
            count, synced = (0, 0) if file is None else (file.count, file.synced_bytes)
            return RecorderStatus(self._path, count, self._bytes, synced, self._problem)

    def _run(self) -> None:
        try:
            self._write_all()
            if self._file is not None:
                self._file.close()
        except (OSError, InputError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            with self._changed:
                self._problem = (
                    f"{error}; nothing was recorded"
                    if isinstance(error, InputError)
                    else f"{self._path}: recording stopped ({reason}), {self._saved()}; check disk "
                    "space and permissions, then record again"
                )
                self._queue.clear()
                self._bytes = 0
                self._changed.notify_all()
            if self._file is not None:
                self._file.abandon()

    def _saved(self) -> str:
        """Text: what the file contains after a failed write."""
        saved = Flushed() if self._file is None else self._file.flushed
        if self._replaces:
            return "nothing was saved, the earlier recording was restored"
        if not saved.messages:
            return "nothing was saved"
        return (
            f"its first {saved.duration_s:.1f} s were saved "
            f"({count_of(saved.messages, 'message')}, {1e-6 * saved.size_bytes:.1f} MB)"
        )

    def _write_all(self) -> None:
        synced, unflushed = time.monotonic(), 0
        while True:
            messages, ending = self._take(SYNC_S / 2)
            for message in self._with_static(messages):
                file = self._file = self._file or McapFile(self._path, compression="lz4")
                file.write(message, message.arrival_ns)
                unflushed += len(message.payload)
                if unflushed >= FLUSH_BYTES:
                    file.flush()
                    unflushed = 0
                with self._changed:
                    self._bytes -= len(message.payload)
                    self._changed.notify_all()
            if ending and not messages:
                return
            if self._file is not None and time.monotonic() - synced >= SYNC_S:
                self._file.sync()
                synced = time.monotonic()

    def _with_static(self, messages: list[Message]) -> list[Message]:
        if not messages or not self._static:
            return messages
        at_ns, static = messages[0].arrival_ns, self._static
        self._static = ()
        return [*(message._replace(arrival_ns=at_ns) for message in static), *messages]

    def _take(self, timeout_s: float) -> tuple[list[Message], bool]:
        with self._changed:
            self._changed.wait_for(lambda: bool(self._queue) or self._ending, timeout_s)
            messages = list(self._queue)
            self._queue.clear()
            return messages, self._ending
