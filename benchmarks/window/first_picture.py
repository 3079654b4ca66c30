"""Process that opens a recording like the command, without earlier imports."""

from __future__ import annotations

import time
from pathlib import Path

import bubbleviz.cli.command_line  # noqa: F401
from bubbleviz_ui.startup_imports import import_the_backend
from bubbleviz_ui.window_session import Startup, WindowSession

FIRST = "first picture at"


def first_picture(recording: str, sensor: str | None) -> None:
    """Open a recording, print when its first picture is drawn, and quit."""
    import_the_backend()
    from bubbleviz.recordings import checked_sensor  # by what was imported just now

    _, chosen = checked_sensor(Path(recording), sensor)
    session, seen = WindowSession(), list[float]()

    def note() -> None:
        if not session.state.facts.is_empty:  # else the membrane at rest
            seen.append(time.time())

    session.window.view.rendered.connect(note)
    session.start(Startup(chosen, Path(recording)), None, None, at_once=True)
    session.wait_for(lambda: bool(seen), "drawing")
    print(f"{FIRST} {seen[0]}", flush=True)
    session.close()
