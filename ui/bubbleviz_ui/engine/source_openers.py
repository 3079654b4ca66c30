"""How the window opens what it can show; called in the solver thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.frame_source import FrameSource
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.sensor_matching import check_fits, preset_for
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation.noisy_loop import NoisyLoop
from bubbleviz.simulation.truth import Truth, truth_of
from bubbleviz.simulation.truth_file import KnownRecording, known_beside
from bubbleviz_ui.model.source_facts import NOTHING_OPEN

RECORDINGS = "Recordings (*.mcap *.db3 *.bag *.yaml);;All files (*)"
"""As file dialogs offer them."""
LIVE_FINER = 2
"""Nodes of the live simulation's mesh for one of the estimator's: frames are made in 15 ms."""


@dataclass(frozen=True, eq=False)
class RecordingOpener:
    """Opens a recording for a sensor; two are never equal, as each stands for one opening."""

    path: Path
    truth: Path | None = None

    def __call__(self, sensor: Sensor) -> FrameSource:
        """Open it, with the truth behind it where it is of a simulation and that is known.

        Raises
        ------
        InputError
            It cannot be opened, does not fit the sensor, or the truth is not its own.
        """
        opened = Recording(self.path)
        try:
            check_fits(opened, sensor, sensor.name)
            if self.truth is not None:
                return KnownRecording(opened, self.truth)
            return known_beside(opened)
        except InputError:
            opened.close()
            raise


def recording(path: Path, truth: Path | None = None) -> Callable[[Sensor], FrameSource]:
    """Opener of a recording, and of its TRUTH.npz where that is not beside it under its name."""
    return RecordingOpener(path, truth)


def sensor_for(path: Path, present: Sensor) -> Sensor:
    """Sensor to open a recording with: the present one if it fits, else the preset that does."""
    with Recording(path) as opened:
        if opened.size == (present.camera.width, present.camera.height):
            return present
        return load_sensor(preset_for(opened))


def synthetic(sensor: Sensor) -> FrameSource:
    """Open the built-in synthetic press, which the window loops as a live sensor.

    All its frames are made now, within seconds: a live sensor does not stutter in its first round.
    Only the noise is new in every round.
    """
    # a recording is opened without the simulator
    from bubbleviz.simulation.synthetic_source import SyntheticSource, default_press

    press, nodes = default_press(sensor), LIVE_FINER * sensor.membrane.nodes
    source = CachedSource(
        SyntheticSource(sensor, press.obj, press.poses, times_s=press.times_s, nodes=nodes)
    )
    for index in range(len(source)):
        _ = source[index]
    return NoisyLoop(source, press.camera, press.noise)


class NothingOpen:
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
