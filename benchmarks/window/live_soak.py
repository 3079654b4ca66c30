"""Soak test: a Zenoh stream is recorded and solved for minutes.

The publisher is a separate process. Every depth image must be in the file, by the publisher's
sequence numbers; memory must not grow; results must be recent.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.records import Message

from benchmarks.window.process_usage import resident_bytes
from bubbleviz.api.estimator import Estimator
from bubbleviz.api.summary import Summary
from bubbleviz.api.watching import Watcher
from bubbleviz.errors import InputError
from bubbleviz.live import LiveStream, Recorder, RecorderStatus, open_stream
from bubbleviz.recordings import IMAGE
from bubbleviz.sensor import Sensor, load_sensor, sensor_to_toml
from bubbleviz.simulation import resized

WARM_UP_S = 20.0  # memory may grow until then: one round of the press fills every buffer
_START_S = 60.0  # s until the first frame, at most


@dataclass(frozen=True)
class SoakReport(Summary):
    """Results of `live`; latency is from stamp to result."""

    seconds: float
    rate_hz: float
    sent: int  # depth images counted by the publisher while subscribed
    recorded: int  # depth images in the file
    missing: int  # gaps of the publisher's count in the file
    repeated: int
    solved: int
    skipped: int  # replaced by newer ones
    latency_median_s: float
    latency_p95_s: float
    latency_worst_s: float
    memory_growth_bytes: int  # highest resident memory after the warm-up minus that at its end
    most_waiting_bytes: int  # of the recorder's queue
    stalls: int
    recording_bytes: int

    @property
    def exit_code(self) -> int:
        """1 when the file lacks a frame, or has one twice."""
        return int(self.missing > 0 or self.repeated > 0)

    def to_text(self) -> str:
        """A few lines for people, with units."""
        return "\n".join(
            [
                f"stream    {self.rate_hz:g} Hz for {self.seconds:.0f} s over Zenoh, loopback",
                f"recorded  {self.recorded} of {self.sent} depth images, {self.missing} missing, "
                f"{self.repeated} twice; {self.recording_bytes / 1e6:.0f} MB",
                f"solved    {self.solved}, {self.skipped} skipped for newer ones",
                f"latency   {1e3 * self.latency_median_s:.1f} ms median, "
                f"{1e3 * self.latency_p95_s:.1f} ms p95, {1e3 * self.latency_worst_s:.0f} ms worst",
                f"memory    {self.memory_growth_bytes / 2**20:+.1f} MiB after the warm-up",
                f"disk      at most {self.most_waiting_bytes / 1e6:.1f} MB waiting, "
                f"{self.stalls} stalls",
            ]
        )


def soak(
    sensor_name: str, seconds: float, rate_hz: float = 60.0, out: Path | None = None
) -> SoakReport:
    """Stream, record and solve for some time; the recording is kept if a path is given."""
    with tempfile.TemporaryDirectory(prefix="bubbleviz-soak-") as folder:
        path = out or Path(folder) / "soak.mcap"
        with Publisher(sensor_name, f"synthetic:?rate={rate_hz:g}") as publisher:
            measured = _run(load_sensor(sensor_name), seconds, path, publisher)
        return report_of(measured, path, seconds, rate_hz)


class Publisher:
    """A process that runs `bubbleviz publish` on a source; killed at the end of its `with`.

    `uri` is the live source that receives its messages.
    """

    def __init__(self, sensor_name: str, source: str) -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.uri = f"zenoh:{endpoint}"
        self._arguments = ["--source", source, "--sensor", sensor_name, "--listen", endpoint]
        self.start()

    def start(self) -> None:
        """Start to publish."""
        code = "from bubbleviz.cli.command_line import main; main()"
        command = [sys.executable, "-c", code, "publish", *self._arguments, "--json"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def images_sent(self) -> int:
        """Stop it normally; returns the number of depth images it sent."""
        self.process.terminate()
        sent = json.loads(self.process.communicate(timeout=30)[0])["sent"]
        return next(int(count) for topic, count in sent.items() if topic.endswith("image_raw"))

    def kill(self) -> None:
        """Kill it as `kill -9` does."""
        self.process.kill()
        self.process.communicate()

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()


def resized_file(sensor: Sensor, size: tuple[int, int], folder: Path, name: str = "sensor") -> str:
    """File of the same sensor and field of view with another image size."""
    other = resized(sensor, *size)
    path = folder / f"{name}.toml"
    path.write_text(sensor_to_toml(other), encoding="utf-8")
    return str(path)


def free_port() -> int:
    """An unused loopback port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Measured:
    """Counts while streaming; `memory` is (s since the start, bytes), `sent` images."""

    solved: int
    skipped: int
    ages_s: list[float]
    memory: list[tuple[float, int]]
    status: RecorderStatus
    sent: int


def _run(sensor: Sensor, seconds: float, path: Path, publisher: Publisher) -> Measured:
    stream, recorder = open_stream(publisher.uri, sensor), Recorder()
    stream.listen(recorder.push)
    recorder.start(path)
    try:
        with stream:
            first = stream.take(_START_S)
            if first is None:
                raise InputError(f"nothing arrived: {stream.status().text}")
            estimator = Estimator(sensor, intrinsics=first.intrinsics, zero_gas=False)
            watcher = Watcher(stream, estimator.solver)
            skipped_before = stream.counters.skipped
            ages, memory = _solve_for(watcher, seconds)
            sent = publisher.images_sent()
            drain(stream)
            skipped = stream.counters.skipped - skipped_before
    finally:
        status = recorder.stop()
    if status.problem:
        raise InputError(status.problem)
    return Measured(len(ages), skipped, ages, memory, status, sent)


def _solve_for(watcher: Watcher, seconds: float) -> tuple[list[float], list[tuple[float, int]]]:
    began = looked = time.monotonic()
    ages: list[float] = []
    memory: list[tuple[float, int]] = []
    while (now := time.monotonic()) - began < seconds:
        result = watcher.step(0.1)
        if result is not None:
            ages.append((time.time_ns() - result.frame.stamp_ns) * 1e-9)
        if now - looked >= 1.0:
            looked = now
            memory.append((now - began, resident_bytes()))
    return ages, memory


def drain(stream: LiveStream) -> None:
    """Wait until no more messages arrive."""
    received = -1
    while stream.counters.received != received:
        received = stream.counters.received
        time.sleep(0.3)


def depth_images(path: Path, prefix: str = "") -> Iterator[Message]:
    """The depth images of some topics in a recording, in file order."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if schema is not None and schema.name == IMAGE and channel.topic.startswith(prefix):
                yield message


def sequences(path: Path, prefix: str = "") -> np.ndarray:
    """Sequence numbers of the depth images of some topics in a recording, in file order."""
    return np.array([message.sequence for message in depth_images(path, prefix)], dtype=np.int64)


def gaps_in(count: np.ndarray) -> tuple[int, int]:
    """Numbers of missing and of repeated values in a sequence."""
    steps = np.diff(np.sort(count))
    return int(np.sum(np.maximum(steps - 1, 0))), int(np.sum(steps == 0))


def report_of(measured: Measured, path: Path, seconds: float, rate_hz: float) -> SoakReport:
    """Report on a recording and the counts of its run; InputError if they are empty."""
    count = sequences(path)
    gaps, repeated = gaps_in(count)
    ages = np.array(measured.ages_s)
    if not (len(count) and len(ages)):
        raise InputError(
            f"{len(count)} images recorded and {len(ages)} solved within "
            f"{seconds:g} s: nothing to report; ask for more --minutes"
        )
    warm_up = min(WARM_UP_S, 0.5 * seconds)
    before = [size for at, size in measured.memory if at <= warm_up]
    after = [size for at, size in measured.memory if at > warm_up]
    return SoakReport(
        seconds=seconds,
        rate_hz=rate_hz,
        sent=measured.sent - int(count.min()) + 1,
        recorded=len(count),
        missing=gaps + measured.sent - int(count.max()),
        repeated=repeated,
        solved=measured.solved,
        skipped=measured.skipped,
        latency_median_s=float(np.median(ages)),
        latency_p95_s=float(np.percentile(ages, 95.0)),
        latency_worst_s=float(ages.max()),
        memory_growth_bytes=max(after) - before[-1] if before and after else 0,
        most_waiting_bytes=measured.status.most_waiting_bytes,
        stalls=measured.status.stalls,
        recording_bytes=path.stat().st_size,
    )
