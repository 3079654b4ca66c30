"""What the window can open: recordings, live streams, the looped press. They differ in data."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.recordings import (
    Frame,
    FrameSource,
    Recording,
    check_fits,
    fitting_sensor,
    image_size,
    open_recording,
)
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import NoisyLoop, RecordingWithTruth, Truth, truth_of, with_truth_file
from bubbleviz_ui.live.live_frames import LiveFrames
from bubbleviz_ui.model.source_facts import NOTHING_OPEN

RECORDINGS = "Recordings (*.mcap *.db3 *.bag *.yaml);;All files (*)"
"""As file dialogs offer them."""
LIVE_NODE_RATIO = 2
"""Nodes of the live simulation's mesh for one of the estimator's: frames are made in 15 ms."""


@dataclass(frozen=True, eq=False)
class Source:
    """Something to open; two are never equal, as each stands for one opening."""

    title: str  # What to call it in a message
    open: Callable[[Sensor], FrameSource]  # Called in the solver thread
    path: Path | None = None  # Of a recording
    truth: Path | None = None  # Its TRUTH.npz where that is not beside it under its name
    stream: LiveFrames | None = None  # Frames that come already, and more of them
    live: bool = False  # It goes on like a live sensor
    name: str | None = None  # In session files; None where it cannot be opened by name

    @classmethod
    def of_recording(cls, path: Path, truth: Path | None = None) -> Source:
        """A recording, which may be of a simulation."""
        name, function = str(path.absolute()), partial(_recording, path, truth)
        return cls(path.name, function, path=path, truth=truth, name=name)

    @classmethod
    def of_stream(cls, frames: LiveFrames) -> Source:
        """Frames of a live sensor, for any sensor file of their camera."""
        return cls(frames.name, lambda _: frames, stream=frames, live=True)


def _recording(path: Path, truth: Path | None, sensor: Sensor) -> FrameSource:
    """Open a recording, with the truth behind it where it is of a simulation and that is known.

    Raises InputError: It cannot be opened, does not fit the sensor, or the truth is not its own.
    """
    opened = open_recording(path)
    try:
        check_fits(opened, sensor, sensor.name)
        if truth is not None and isinstance(opened, Recording):
            return RecordingWithTruth(opened, truth)
        return with_truth_file(opened)
    except InputError:
        opened.close()
        raise


def sensor_for(path: Path, present: Sensor) -> Sensor:
    """Sensor to open a recording with: the present one if it fits, else the preset that does."""
    with closing(open_recording(path)) as opened:
        if image_size(opened) == (present.camera.width, present.camera.height):
            return present
        return fitting_sensor(opened, None)[1]


def _synthetic(sensor: Sensor) -> FrameSource:
    """Open the built-in synthetic press, which the window loops as a live sensor.

    All its frames are made now, within seconds: a live sensor does not stutter in its first round.
    Only the noise is new in every round.
    """
    # a recording is opened without the simulator
    from bubbleviz.simulation import SyntheticSource, default_press

    press, nodes = default_press(sensor), LIVE_NODE_RATIO * sensor.membrane.nodes
    source = CachedSource(
        SyntheticSource(sensor, press.obj, press.poses, times_s=press.times_s, nodes=nodes)
    )
    for index in range(len(source)):
        _ = source[index]
    return NoisyLoop(source, press.camera, press.noise)


class _EmptySource:
    """What is there while nothing is open: one image in which no pixel has a return."""

    def __init__(self, sensor: Sensor) -> None:
        self.name, self.times_s = NOTHING_OPEN, np.zeros(1)
        self._size = sensor.camera.height, sensor.camera.width

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> Frame:
        return Frame(index, 0.0, np.full(self._size, np.nan, np.float32))

    def close(self) -> None:
        """Nothing is held."""


class CachedSource:
    """Keeps the frames of a short source that computes them, so a loop costs them once."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._frames: dict[int, Frame] = {}
        self.name = source.name
        self.times_s = source.times_s

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> Frame:
        if index not in self._frames:
            self._frames[index] = self._source[index]
        return self._frames[index]

    def truth(self, index: int) -> Truth | None:
        """What is true of a frame."""
        return truth_of(self._source, index)

    def close(self) -> None:
        """Close the source."""
        self._source.close()


SYNTHETIC = Source("synthetic press", _synthetic, live=True, name="synthetic:")
NO_SOURCE = Source("the sensor at rest", _EmptySource)
"""What is open while nothing is."""
