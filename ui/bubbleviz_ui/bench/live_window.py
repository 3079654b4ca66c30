"""A window on live sensors, for benchmarks: under a screen of its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bubbleviz.errors import InputError
from bubbleviz.live.session_preset import SessionPreset
from bubbleviz.sensor import load_sensor
from bubbleviz_ui.app import screen_for_pictures
from bubbleviz_ui.live.connection import LiveRun
from bubbleviz_ui.window_session import WindowSession, window_session

SIZE = (1280, 800)  # pixels: a small laptop's screen


@contextmanager
def live_window(preset: SessionPreset) -> Iterator[WindowSession]:
    """A window that shows live sensors, under a screen of its own."""
    first = load_sensor(preset.sensors[0].sensor)
    with (
        screen_for_pictures(*SIZE),
        window_session(first, None, None, live=preset) as session,
    ):
        session.window.resize(*SIZE)
        session.window.show()
        session.wait_for(lambda: session.window.view.render_count > 0, "the first picture")
        yield session


def run_of(session: WindowSession) -> LiveRun:
    """What is connected, once every sensor of it is shown."""
    live, pair = session.window.live_controller, session.window.pair

    def shown() -> bool:
        run, second = live.run, pair.second
        alone = run is not None and len(run.frames) == 1
        return alone or (second is not None and second.opened is not None)

    session.wait_for(shown, "connecting")
    if live.run is None:
        raise InputError("bench live: nothing is connected")
    return live.run
