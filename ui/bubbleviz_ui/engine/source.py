"""Sources that the window can open: recordings, live streams, the looped synthetic press."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bubbleviz.errors import InputError, UnknownCameraError
from bubbleviz.recordings import (
    Frame,
    FrameSource,
    HeldFrames,
    Recording,
    check_fits,
    fitting_sensor,
    image_size,
    open_recording,
)
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import LoopedSource, RecordingWithTruth, with_truth_file
from bubbleviz_ui.engine.live_frames import LiveFrames
from bubbleviz_ui.model.source_facts import NOTHING_OPEN

RECORDINGS = "Recordings (*.mcap *.db3 *.bag *.yaml);;All files (*)"
"""Filter of file dialogs."""
LIVE_NODE_RATIO = 2
"""Ratio of mesh nodes, simulation to estimator; a frame is simulated in 15 ms."""


@dataclass(frozen=True, eq=False)
class Source:
    """Something to open; compared by identity."""

    title: str  # Name in messages
    open: Callable[[Sensor], FrameSource]  # Called in the solver thread
    path: Path | None = None  # Of a recording
    depth_topic: str | None = None  # Of its depth images; None for the first
    truth: Path | None = None  # TRUTH.npz, if not next to the recording with the same name
    stream: LiveFrames | None = None  # Of a live sensor
    live: bool = False  # Behaves like a live sensor
    name: str | None = None  # In session files; None if it cannot be opened by name

    @classmethod
    def of_recording(
        cls, path: Path, truth: Path | None = None, depth_topic: str | None = None
    ) -> Source:
        """A recording, real or simulated."""
        name, function = str(path.absolute()), partial(_recording, path, truth, depth_topic)
        return cls(path.name, function, path, depth_topic, truth, name=name)

    @classmethod
    def of_stream(cls, frames: LiveFrames) -> Source:
        """Frames of a live sensor, with any sensor file for its camera."""
        return cls(frames.name, lambda _: frames, stream=frames, live=True)


@dataclass(frozen=True, eq=False)
class PlacedSensor:
    """One of several sensors that are opened together: live, or of recordings."""

    name: str
    colour: str
    source: Source
    open_sensor: Callable[[], Sensor]  # Called in the solver thread
    T_W_B: np.ndarray  # (4, 4); the same for all: they are drawn side by side


def _recording(
    path: Path, truth: Path | None, depth_topic: str | None, sensor: Sensor
) -> FrameSource:
    """Open a recording, with its ground truth if it is simulated and has one.

    Raises InputError: It cannot be opened, or does not fit the sensor or the ground truth.
    """
    opened = open_recording(path, depth_topic=depth_topic)
    try:
        check_fits(opened, sensor, sensor.name)
        if truth is not None and isinstance(opened, Recording):
            return RecordingWithTruth(opened, truth)
        return with_truth_file(opened)
    except InputError:
        opened.close()
        raise


def sensor_for(path: Path, *known: Sensor, depth_topic: str | None = None) -> Sensor:
    """Sensor for a recording: the first known one that fits, else the matching preset.

    Raises UnknownCameraError: There is none.
    """
    with closing(open_recording(path, depth_topic=depth_topic)) as opened:
        size = image_size(opened)
        for sensor in known:
            if size == (sensor.camera.width, sensor.camera.height):
                return sensor
        try:
            return fitting_sensor(opened, None)[1]
        except UnknownCameraError as error:
            raise UnknownCameraError(
                f"{opened.name}: no single preset has a camera of {size[0]}×{size[1]} pixels; "
                "choose the sensor file of this camera",
                size,
            ) from error


def _synthetic(sensor: Sensor) -> FrameSource:
    """Open the built-in synthetic press, which the window loops as a live sensor.

    A frame is simulated when it is first shown; only the noise differs between loops.
    """
    # not at start: opening a recording needs no simulator
    from bubbleviz.simulation import DepthNoise, default_press

    nodes = LIVE_NODE_RATIO * sensor.membrane.nodes
    press = default_press(sensor, nodes=nodes, noise=DepthNoise())
    noise = DepthNoise(relative=sensor.camera.noise_relative)
    return LoopedSource(press, press.camera, noise)


def _at_rest(sensor: Sensor) -> FrameSource:
    """Source while none is open: one depth image without returns."""
    depth_m = np.full((sensor.camera.height, sensor.camera.width), np.nan, np.float32)
    return HeldFrames([Frame(0, 0.0, depth_m)], NOTHING_OPEN)


SYNTHETIC = Source("synthetic press", _synthetic, live=True, name="synthetic:")
NO_SOURCE = Source("the sensor at rest", _at_rest)
"""Open while no other source is."""
