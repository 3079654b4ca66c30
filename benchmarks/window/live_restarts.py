"""Reconnection to a publisher that is killed and restarted."""

from __future__ import annotations

import random
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.window.bench_window import live_window, recorded_run
from benchmarks.window.live_soak import Publisher, depth_images
from benchmarks.window.replay_rate import run_for
from bubbleviz.api.summary import Summary
from bubbleviz.recordings import IMAGE, Message
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.window_session import WindowSession


@dataclass(frozen=True)
class RestartReport(Summary):
    """Results of `restarts`."""

    kills: int
    recovered: int  # how often the window showed new frames after a restart of the publisher
    detected_s: list[float]  # how long the bar still showed `live` after each kill
    arrived: int  # depth images that arrived while recording
    recorded: int  # those in the file

    @property
    def passed(self) -> bool:
        """Whether nothing was lost and the window recovered each time."""
        return self.recovered == self.kills and self.arrived == self.recorded

    def to_text(self) -> str:
        """A few lines for people, with units."""
        gone = self.detected_s
        return (
            f"killed    {self.kills} times, recovered {self.recovered} times\n"
            f"noticed   after {median(gone):.2f} s median, {max(gone):.2f} s at most\n"
            f"recorded  {self.recorded} of {self.arrived} depth images that arrived"
        )


def restart_bench(sensor_name: str, times: int, seed: int = 0) -> RestartReport:
    """Kill and restart the publisher, at random moments, while the window records."""
    with (
        tempfile.TemporaryDirectory(prefix="bubbleviz-restarts-") as folder,
        Publisher(sensor_name, "synthetic:?rate=60&frames=30") as robot,
        live_window(single(robot.uri, sensor_name)) as session,
    ):
        path = Path(folder) / "restarts.mcap"
        return _restart(session, robot, path, times, random.Random(seed))


def _restart(
    session: WindowSession, robot: Publisher, path: Path, times: int, chance: random.Random
) -> RestartReport:
    run, live = recorded_run(session, path), session.window.live_controller
    stream, arrived = run.frames[0].stream, set[int]()

    def note(message: Message) -> None:
        if message.type == IMAGE:
            arrived.add(message.arrival_ns)

    forget = stream.listen(note)
    gone, recovered = list[float](), 0
    for _ in range(times):
        run_for(chance.uniform(0.3, 2.0))
        robot.kill()
        killed, before = time.monotonic(), len(run.frames[0])
        session.wait_for(lambda: "live" not in session.window.live.state.text(), "going stale")
        gone.append(time.monotonic() - killed)
        run_for(chance.uniform(0.0, 2.0))
        robot.start()
        recovered += _shows_more_than(session, before)
    forget()
    live.close()
    logged = {message.log_time for message in depth_images(path)}
    return RestartReport(times, recovered, gone, len(arrived), len(arrived & logged))


def _shows_more_than(session: WindowSession, frames: int) -> bool:
    """Wait until a later frame is shown and the bar shows `live`."""

    def shown() -> bool:
        result = session.controller.result
        later = result is not None and result.frame.index > frames
        return later and "live" in session.window.live.state.text()

    session.wait_for(shown, "coming back")
    return True
