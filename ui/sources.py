"""How the window opens what it can show; called in the solver thread."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bubbleviz.frames.source import FrameSource
from bubbleviz.sensor import Sensor


def recording(path: Path) -> Callable[[Sensor], FrameSource]:
    """Opener of a recording."""

    def open_recording(sensor: Sensor) -> FrameSource:
        from bubbleviz.frames.recording import Recording

        return Recording(path)

    return open_recording


def synthetic(sensor: Sensor) -> FrameSource:
    """Open the built-in synthetic press, which the window loops as a live sensor."""
    from bubbleviz.frames.synthetic import default_press

    return default_press(sensor)
