"""The work of `bubbleviz bench restarts`: a publisher that dies and comes back."""

from __future__ import annotations

import json
import random
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from mcap.reader import make_reader

from bubbleviz.frames.depth_topics import IMAGE
from bubbleviz.live.raw_message import RawMessage
from bubbleviz_ui.bench.live_soak import free_port, start_publisher
from bubbleviz_ui.bench.live_window import live_window, run_of
from bubbleviz_ui.bench.replay_rate import run_for
from bubbleviz_ui.live.connection import single
from bubbleviz_ui.window_session import WindowSession


@dataclass(frozen=True)
class RestartReport:
    """What `bench restarts` saw.

    Attributes
    ----------
    kills : int
    recovered : int
        How often the window showed new frames after the publisher came back.
    seen_gone_s : list of float
        How long the bar went on saying `live` after each kill.
    arrived, recorded : int
        Depth images that arrived here while recording, and those in the file.
    """

    kills: int
    recovered: int
    seen_gone_s: list[float]
    arrived: int
    recorded: int

    @property
    def passed(self) -> bool:
        """Whether nothing was lost and the window came back each time."""
        return self.recovered == self.kills and self.arrived == self.recorded

    def to_json(self) -> str:
        """JSON object with the attributes as keys."""
        return json.dumps(asdict(self), indent=2, allow_nan=False)

    def to_text(self) -> str:
        """A few lines for people, with units."""
        gone = self.seen_gone_s
        return (
            f"killed    {self.kills} times, recovered {self.recovered} times\n"
            f"noticed   after {median(gone):.2f} s median, {max(gone):.2f} s at most\n"
            f"recorded  {self.recorded} of {self.arrived} depth images that arrived"
        )


class Robot:
    """A process that publishes, and can be killed."""

    def __init__(self, sensor_name: str) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._sensor_name = sensor_name
        self.start()

    def start(self) -> None:
        """Begin to publish."""
        source = "synthetic:?rate=60&frames=30"
        self._process = start_publisher(self._sensor_name, self.endpoint, source)

    def kill(self) -> None:
        """Kill it as `kill -9` does."""
        self._process.kill()
        self._process.communicate()


def restart_bench(sensor_name: str, times: int, seed: int = 0) -> RestartReport:
    """Kill the publisher and start it anew, at random moments, while the window records."""
    robot = Robot(sensor_name)
    with tempfile.TemporaryDirectory(prefix="bubbleviz-restarts-") as folder:
        path = Path(folder) / "restarts.mcap"
        try:
            with live_window(single(f"zenoh:{robot.endpoint}", sensor_name)) as session:
                return _restart(session, robot, path, times, random.Random(seed))
        finally:
            robot.kill()


def _restart(
    session: WindowSession, robot: Robot, path: Path, times: int, chance: random.Random
) -> RestartReport:
    run, live = run_of(session), session.window.live_controller
    stream, arrived = run.frames[0].stream, set[int]()

    def note(message: RawMessage) -> None:
        if message.type == IMAGE:
            arrived.add(message.arrival_ns)

    live.recording.start(run.session.recorder, path)
    session.wait_for(lambda: live.recording.state() is not None, "the recording")
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
    return RestartReport(times, recovered, gone, len(arrived), len(arrived & _logged(path)))


def _shows_more_than(session: WindowSession, frames: int) -> bool:
    """Wait until a later frame is shown and the bar says that it is live."""

    def shown() -> bool:
        result = session.controller.result
        later = result is not None and result.frame.index > frames
        return later and "live" in session.window.live.state.text()

    session.wait_for(shown, "coming back")
    return True


def _logged(path: Path) -> set[int]:
    """When the depth images of a recording arrived, ns since 1970."""
    with path.open("rb") as file:
        return {
            message.log_time
            for schema, _, message in make_reader(file).iter_messages()
            if schema is not None and schema.name == IMAGE
        }
