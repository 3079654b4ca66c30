"""Two cameras over Zenoh into one window that records them.

Their images are simulated and encoded before the first is sent, and replayed, so that the cost of
sending is measured separately from the window.
"""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from statistics import quantiles

from benchmarks.window.bench_window import live_window, recorded_run
from benchmarks.window.live_soak import Publisher, gaps_in, resized_file, sequences
from benchmarks.window.process_usage import process_seconds, thread_seconds
from benchmarks.window.replay_rate import beats, run_for
from bubbleviz.api.summary import Summary
from bubbleviz.errors import InputError
from bubbleviz.live import SessionPreset
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.engine.upkeep import resident_mib
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.window_session import WindowSession

WARM_UP_S = 3.0
SHARE_SHOWN = 0.002  # threads with less of a core than this are omitted


@dataclass(frozen=True)
class PairReport(Summary):
    """Results of `pair`; pairs of numbers are of the chosen and of the other sensor."""

    seconds: float
    rate_hz: float
    width: int  # of both cameras, pixels
    height: int
    received_hz: tuple[float, float]
    solved_hz: tuple[float, float]
    pictures_hz: float
    latency_median_s: float  # stamp to picture, of the chosen sensor
    latency_p95_s: float
    recorded: int  # depth images of both in the recording made meanwhile
    missing: int  # by the publishers' counts
    repeated: int
    blocked_p99_ms: float  # between two beats of the event loop
    blocked_ms: float
    memory_growth_mib: float
    cores_used: dict[str, float]  # processor time of threads and processes a second
    load_average: float
    cores: int

    @property
    def exit_code(self) -> int:
        """1 when the recording lacks a frame, or has one twice."""
        return int(self.missing > 0 or self.repeated > 0)

    def to_text(self) -> str:
        """A few lines for people, with units."""
        received, solved, used = self.received_hz, self.solved_hz, dict(self.cores_used)
        publishers = used.pop("publishers", 0.0)
        threads = ", ".join(f"{name} {share:.2f}" for name, share in used.items())
        return "\n".join(
            [
                f"stream    2 × {self.width}×{self.height} at {self.rate_hz:g} Hz for "
                f"{self.seconds:.0f} s; arrived {received[0]:.1f} and {received[1]:.1f} Hz",
                f"solved    {solved[0]:.1f} and {solved[1]:.1f} Hz",
                f"window    {self.pictures_hz:.1f} pictures/s; latency "
                f"{1e3 * self.latency_median_s:.0f} ms median, {1e3 * self.latency_p95_s:.0f} ms "
                f"p95; blocked {self.blocked_p99_ms:.0f} ms p99, {self.blocked_ms:.0f} ms at most",
                f"recorded  {self.recorded} depth images, {self.missing} missing, "
                f"{self.repeated} twice",
                f"memory    {self.memory_growth_mib:+.1f} MiB",
                f"cores     {sum(used.values()):.2f} used: {threads}; publishers {publishers:.2f}",
                f"machine   load {self.load_average:.1f} on {self.cores} cores",
            ]
        )


def pair_bench(
    preset: SessionPreset, seconds: float, rate_hz: float = 30.0, size: tuple[int, int] = (640, 480)
) -> PairReport:
    """Two simulated cameras, each in its own process, over Zenoh into one window."""
    publishers, places = list[Publisher](), []
    with tempfile.TemporaryDirectory(prefix="bubbleviz-pair-") as folder, ExitStack() as stack:
        for place in preset.sensors:
            sensor = resized_file(load_sensor(place.sensor), size, Path(folder), place.name)
            source = f"{place.source}&rate={rate_hz:g}&encoding=16UC1&frames=90"
            publishers.append(stack.enter_context(Publisher(sensor, source)))
            update = {"sensor": sensor, "source": publishers[-1].uri}
            places.append(place.model_copy(update=update))
        session = stack.enter_context(
            live_window(preset.model_copy(update={"sensors": tuple(places)}))
        )
        return _count_pair(session, seconds, rate_hz, size, publishers, Path(folder))


@dataclass(frozen=True)
class _Counts:
    """Counts from the start of a session."""

    at_s: float
    received: list[int]
    solved: list[int]
    pictures: int
    used_s: dict[str, float]
    memory_mib: float

    @classmethod
    def now(cls, session: WindowSession, run: LiveRun, publishers: list[Publisher]) -> _Counts:
        used = thread_seconds()
        used["publishers"] = sum(process_seconds(each.process.pid) for each in publishers)
        solvers = [each.pid for each in active_children() if each.pid is not None]
        used["solver processes"] = sum(process_seconds(pid) for pid in solvers)
        return cls(
            time.monotonic(),
            [frames.stream.counters.frames for frames in run.frames],
            [len(frames) for frames in run.frames],
            session.window.view.render_count,
            used,
            resident_mib(),
        )


def _solve_apart(session: WindowSession) -> bool:
    """Whether the solver processes of both sensors are ready."""
    sources = [client.solver.current for client in session.controller.clients]
    processes = [None if source is None else source.solver_process for source in sources]
    return all(process is not None and process.pid is not None for process in processes)


def _count_pair(
    session: WindowSession,
    seconds: float,
    rate_hz: float,
    size: tuple[int, int],
    publishers: list[Publisher],
    folder: Path,
) -> PairReport:
    path, live = folder / "pair.mcap", session.window.live_controller
    run = recorded_run(session, path)
    session.wait_for(partial(_solve_apart, session), "starting the solver processes")
    run_for(WARM_UP_S)
    session.window.display_latency.begin(10**6)
    before = _Counts.now(session, run, publishers)
    with beats() as gaps_ms:
        run_for(seconds)
    after, ages = _Counts.now(session, run, publishers), session.window.display_latency.report()
    if ages is None:
        raise InputError("no picture was drawn")
    live.close()
    counts = [sequences(path, f"/{place.name}") for place in run.preset.sensors]
    gaps = [gaps_in(count) for count in counts]
    elapsed = after.at_s - before.at_s

    def rates(before: list[int], now: list[int]) -> tuple[float, float]:
        first, second = ((b - a) / elapsed for a, b in zip(before, now, strict=True))
        return first, second

    used = {
        name: (now_s - before.used_s.get(name, 0.0)) / elapsed
        for name, now_s in after.used_s.items()
    }
    told = {name: share for name, share in used.items() if share > SHARE_SHOWN}
    return PairReport(
        seconds=elapsed,
        rate_hz=rate_hz,
        width=size[0],
        height=size[1],
        received_hz=rates(before.received, after.received),
        solved_hz=rates(before.solved, after.solved),
        pictures_hz=(after.pictures - before.pictures) / elapsed,
        latency_median_s=ages.median_s,
        latency_p95_s=ages.p95_s,
        recorded=sum(len(count) for count in counts),
        missing=sum(missing for missing, _ in gaps),
        repeated=sum(repeated for _, repeated in gaps),
        blocked_p99_ms=quantiles(gaps_ms, n=100)[-1],
        blocked_ms=max(gaps_ms),
        memory_growth_mib=after.memory_mib - before.memory_mib,
        cores_used=dict(sorted(told.items(), key=lambda each: -each[1])),
        load_average=os.getloadavg()[0],
        cores=os.cpu_count() or 1,
    )
