"""Window under test, of a small laptop's size, on its own virtual screen."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bubbleviz.errors import InputError
from bubbleviz.live import SessionPreset
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.window_session import Startup, WindowSession, window_session

SIZE = (1280, 800)  # pixels: a small laptop's screen


@contextmanager
def bench_window(
    sensor: Sensor,
    recording: Path | None,
    frame: int | None = None,
    live: SessionPreset | None = None,
) -> Iterator[WindowSession]:
    """A window as `window_session` opens it, on its own virtual screen."""
    with (
        screen_for_pictures(*SIZE),
        window_session(Startup(sensor, recording, frame, live=live)) as session,
    ):
        session.window.resize(*SIZE)
        session.window.show()
        yield session


@contextmanager
def live_window(preset: SessionPreset) -> Iterator[WindowSession]:
    """A window that shows live sensors, and has drawn its first picture."""
    first = load_sensor(preset.sensors[0].sensor)
    with bench_window(first, None, live=preset) as session:
        session.wait_for(lambda: session.window.view.render_count > 0, "the first picture")
        yield session


def recorded_run(session: WindowSession, path: Path) -> LiveRun:
    """The live run, once both sensors are shown; recorded from then on."""
    live, controller = session.window.live_controller, session.controller

    def shown() -> bool:
        return bool(controller.others)

    session.wait_for(shown, "connecting")
    if live.run is None:
        raise InputError("nothing is connected")
    live.recording.start(live.run.session.recorder, path)
    session.wait_for(lambda: live.recording.status() is not None, "the recording")
    return live.run
