"""The work of `bubbleviz record`: a source into a file, no window."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from bubbleviz.commands.stop_signals import stopped_by_signals
from bubbleviz.commands.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.live.live_stream import LiveStream
from bubbleviz.live.sinks.recorder import Recorder, RecorderStatus
from bubbleviz.live.sources.open_stream import open_stream, patience_s
from bubbleviz.sensor import Sensor
from bubbleviz.wording import count_of

_LOOK_S = 0.1  # s between looks at the stream; chosen


@dataclass(frozen=True)
class RecordSummary(Summary):
    """Summary of `record`.

    Attributes
    ----------
    source, out : str
    messages, frames : int
        Messages recorded, and depth images among them that make frames.
    duration_s : float
        From the first message to the end, s.
    size_bytes : int
    most_waiting_bytes, stalls : int
        How far the disk was behind at worst, and how often the source had to wait for it.
    counters : dict
        What was wrong with messages, see `Counters`; they are recorded all the same.
    """

    source: str
    out: str
    messages: int
    frames: int
    duration_s: float
    size_bytes: int
    most_waiting_bytes: int
    stalls: int
    counters: dict[str, Any]

    def to_text(self) -> str:
        """Text for the terminal, with units."""
        lines = [
            f"wrote   {self.out}, {self.size_bytes / 1e6:.1f} MB",
            f"frames  {self.frames} in {self.duration_s:.2f} s, "
            f"{count_of(self.messages, 'message')}",
        ]
        wrong = {
            name: count
            for name, count in self.counters.items()
            if isinstance(count, int) and count and name not in ("received", "frames", "skipped")
        }
        if wrong:
            what = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in wrong.items())
            lines.append(f"notes   {what}; {self.counters['problem']}".rstrip("; "))
        return "\n".join(lines)


def record_source(
    source: str, sensor: Sensor, out: Path, duration_s: float | None = None
) -> RecordSummary:
    """Record until the duration is over, the source ends, or ^C; the file is whole each time.

    Parameters
    ----------
    source : str
        As `--source`.
    sensor : Sensor
        Simulated by `synthetic:`.
    out : Path
        `X.mcap`, or a rosbag2 folder.
    duration_s : float, optional
        Counted from the first message, s.

    Raises
    ------
    InputError
        The source or the file cannot be opened, nothing arrived, or the disk refused.
    """
    stream = open_stream(source, sensor, any_size=True)
    recorder = Recorder()
    recorder.listen_to(stream)
    recorder.start(out)
    first: float | None = None
    try:
        with stopped_by_signals() as stop:
            try:
                stream.start()
                first = _wait(stream, recorder, stop, duration_s, patience_s(source))
            finally:
                stream.stop()
    finally:
        status = recorder.stop()
    _check(status, stream, source)
    now = time.monotonic()
    return _summary(source, status, stream, now - (first or now))


def _summary(
    source: str, status: RecorderStatus, stream: LiveStream, duration_s: float
) -> RecordSummary:
    counters = stream.counters()
    return RecordSummary(
        source=source,
        out=str(status.path),
        messages=status.messages,
        frames=counters.frames,
        duration_s=duration_s,
        size_bytes=status.size_bytes,
        most_waiting_bytes=status.most_waiting_bytes,
        stalls=status.stalls,
        counters=counters.as_dict(),
    )


def _wait(
    stream: LiveStream,
    recorder: Recorder,
    stop: threading.Event,
    duration_s: float | None,
    patience: float,
) -> float | None:
    """Wait until recording ends; returns when the first message came (`time.monotonic`)."""
    began, first = time.monotonic(), None
    with tqdm(unit=" messages", disable=None, file=sys.stderr) as bar:  # only on a terminal
        while not stop.wait(_LOOK_S if first is None else 0.5 * _LOOK_S):
            status = recorder.status()
            if status is None or status.problem:
                return first
            stream.take()  # frees the slot of a frame that is not solved here
            bar.n = status.messages
            bar.set_postfix_str(f"{status.size_bytes / 1e6:.1f} MB, {stream.status().text}")
            now = time.monotonic()
            if first is None and stream.counters().received:
                first = now
            if stream.source.link() == "ended":
                return first
            if duration_s is None:
                continue
            if now - (first or now) >= duration_s:
                return first
            if first is None and now - began > patience:
                return None
    return first


def _check(status: RecorderStatus, stream: LiveStream, source: str) -> None:
    if status.problem:
        raise InputError(status.problem)
    problem, lost = stream.source.problem(), stream.source.link() == "lost"
    if problem and not (lost and status.messages):  # what came before it was lost is in the file
        raise InputError(f"--source {source}: {problem}")
    if not status.messages:
        offered = ", ".join(topic.name for topic in stream.topics())
        found = f"topics there: {offered}" if offered else "no topics were found"
        raise InputError(f"--source {source}: nothing arrived ({found}); nothing was written")
