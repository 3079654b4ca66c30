"""Estimating contact and following objects, in a frame, in frames, and live."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, overload

import numpy as np

from bubbleviz.api.blas_threads import OneBlasThread
from bubbleviz.api.chosen_frames import Frames
from bubbleviz.api.connecting import Stream
from bubbleviz.api.frame_result import FrameResult
from bubbleviz.api.held_frames import HeldFrames
from bubbleviz.api.run import Run
from bubbleviz.calibration.pressure_zero import zero_of
from bubbleviz.commands.estimate import patch_options, solved
from bubbleviz.commands.pose import followed
from bubbleviz.commands.watch import Watcher
from bubbleviz.errors import InputError
from bubbleviz.files.pose_reader import parse_pose
from bubbleviz.frames.frame import Frame
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.sensor_matching import AUTO, fitting_sensor, preset_of_size
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.live.source_status import STOPPED_AFTER_S
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import Sensor, load_sensor

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch"})
"""Pixels of the patch are found when they are asked for."""
NO_IMAGE = np.empty((0, 0), np.float32)
"""In place of the depth images of a `Run`, which would fill the memory."""
SensorName = str | Path | Sensor


@overload
def estimate(
    frames: Frame,
    sensor: SensorName = AUTO,
    *,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
) -> FrameResult: ...
@overload
def estimate(
    frames: Sequence[Frame],
    sensor: SensorName = AUTO,
    *,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
) -> Run: ...
@overload
def estimate(
    frames: Stream,
    sensor: SensorName = AUTO,
    *,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    timeout_s: float | None = STOPPED_AFTER_S,
) -> Iterator[FrameResult]: ...
def estimate(
    frames: Frame | Sequence[Frame] | Stream,
    sensor: SensorName = AUTO,
    *,
    kappa: float | None = None,
    solver: str | None = None,
    friction: float | None = None,
    zero_gas: bool = True,
    timeout_s: float | None = STOPPED_AFTER_S,
) -> FrameResult | Run | Iterator[FrameResult]:
    """Estimate membrane, contact pressure (Eq. 23), contact patch and force.

    The numbers are those of `bubbleviz estimate`: every frame is started where the last one ended.

    Parameters
    ----------
    frames : Frame, sequence of Frame or Stream
        What `open`, `simulate` or `connect` gave, or a part of it.
    sensor : str, path or Sensor
        Sensor file or preset; `auto` is the preset with the images' size, or the stream's sensor.
    kappa : float, optional
        Patch threshold over the mean contact pressure (V-C), in place of the physical one.
    solver : str, optional
        `rubber`: the exact membrane, default where the sensor has a pre-stretch; `linear` and
        `paper` (the QP of the paper, by OSQP): constant tension; `fast`: linear on a coarse mesh.
    friction : float, optional
        Coefficient of friction to expect of contacts with the exact membrane, 1 by default; 0 for
        contacts without friction.
    zero_gas : bool
        Shift the measured gas pressure so that at a rest it is the sensor file's; without a rest
        it is known within the weather's ±2 kPa, which the force's interval holds. If not, it is
        believed as it is.
    timeout_s : float, optional
        How long a frame of a stream may take, s; None waits for ever.

    Returns
    -------
    FrameResult, Run or iterator of FrameResult
        Of a frame, of frames, and of a stream: its newest frame each time.

    Raises
    ------
    InputError
        Sensor and frames do not fit together, or no frame has data (in one line that says what to
        do).
    StreamStoppedError
        No frame of a stream came in `timeout_s` (an `InputError`, too).

    Examples
    --------
    >>> run = bv.estimate(bv.open("press.mcap")[60:90])
    >>> run.force_n.shape
    (30, 3)
    """
    options = patch_options(kappa)
    if isinstance(frames, Stream):
        watcher = Watcher.on(
            frames.live,
            frames.uri,
            _sensor_of_stream(frames, sensor),
            solver=solver,
            friction=friction,
            zero=zero_gas,
            options=options,
        )
        return _watched(watcher, timeout_s)
    chosen = _as_frames(frames)
    with OneBlasThread():
        pipeline = _pipeline(chosen, sensor, solver, friction)
        zero = zero_of(chosen.source, pipeline) if zero_gas else None
        results = solved(chosen.source, chosen.chosen, pipeline, PRODUCTS, options, zero)
        return _found(frames, results, pipeline)


def register(
    frame: Frame,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    *,
    init: str | np.ndarray | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
) -> FrameResult:
    """Find where a known object is in one frame, by dual-stage registration.

    Parameters
    ----------
    frame : Frame
    object : str, path or RigidObject
        Mesh file or preset.
    sensor : str, path or Sensor
        As of `estimate`.
    init : str or (4, 4) array, optional
        T_B_O to about 5 mm and 10°, or "x y z qx qy qz qw"; searched for by default.
    unit : {"m", "mm"}, optional
        Of the object's file; by default millimetres where its name ends in `_mm`.
    solver, friction
        As of `estimate`.

    Returns
    -------
    FrameResult
        Its `T_B_O` (4, 4), and `pose` with covariance and what contact does not determine.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together, or there is no pose.
    """
    return track([frame], object, sensor, init=init, unit=unit, solver=solver, friction=friction)[0]


@overload
def track(
    frames: Sequence[Frame],
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    *,
    init: str | np.ndarray | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
) -> Run: ...
@overload
def track(
    frames: Stream,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    *,
    init: str | np.ndarray | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
    timeout_s: float | None = STOPPED_AFTER_S,
) -> Iterator[FrameResult]: ...
def track(
    frames: Sequence[Frame] | Stream,
    object: str | Path | RigidObject,
    sensor: SensorName = AUTO,
    *,
    init: str | np.ndarray | None = None,
    unit: Literal["m", "mm"] | None = None,
    solver: str | None = None,
    friction: float | None = None,
    timeout_s: float | None = STOPPED_AFTER_S,
) -> Run | Iterator[FrameResult]:
    """Follow a known object through frames, as `bubbleviz pose` does.

    Parameters
    ----------
    frames : sequence of Frame or Stream
    object, sensor, init, unit, solver, friction
        As of `register`; `init` is of the first frame.
    timeout_s : float, optional
        As of `estimate`.

    Returns
    -------
    Run or iterator of FrameResult
        With `T_B_O` and columns `pose_…`; a pose that is `lost` is the last good one.

    Raises
    ------
    InputError
        Something given does not exist or does not fit together, or no frame has a pose.
    """
    start = parse_pose(init) if isinstance(init, str) else init
    obj = load_object(object, unit)
    if isinstance(frames, Stream):
        own = _sensor_of_stream(frames, sensor)
        watcher = Watcher.on(
            frames.live, frames.uri, own, solver=solver, friction=friction, obj=obj, start=start
        )
        return _watched(watcher, timeout_s)
    chosen = _as_frames(frames)
    with OneBlasThread():
        pipeline = _pipeline(chosen, sensor, solver, friction)
        pipeline.follow(obj, start)
        zero = zero_of(chosen.source, pipeline)
        results = followed(chosen.source, chosen.chosen, pipeline, zero=zero)
        found = _found(frames, results, pipeline)
    assert isinstance(found, Run)
    return found


def _as_frames(frames: Frame | Sequence[Frame]) -> Frames:
    held = [frames] if isinstance(frames, Frame) else frames
    if not len(held):
        raise InputError("no frames were given; choose some")
    return held if isinstance(held, Frames) else Frames(HeldFrames(held))


def _pipeline(
    frames: Frames, sensor: SensorName, solver: str | None, friction: float | None
) -> Pipeline:
    options = EstimatorOptions.named(solver, friction)
    source = frames.source
    if isinstance(source, Recording):
        return Pipeline.of(fitting_sensor(source, sensor)[1], source.intrinsics, options)
    first = frames[0]
    if str(sensor) == AUTO:
        height, width = first.depth_m.shape
        sensor = preset_of_size((width, height), frames.name)
    return Pipeline.of(load_sensor(sensor), first.intrinsics, options)


def _found(
    frames: Frame | Sequence[Frame], results: Iterator[Result], pipeline: Pipeline
) -> FrameResult | Run:
    """Results as they are handed out: those of many frames without the depth images."""
    if isinstance(frames, Frame):
        (result,) = results
        return FrameResult(result, pipeline.model)
    light = (replace(each, frame=replace(each.frame, depth_m=NO_IMAGE)) for each in results)
    return Run([FrameResult(each, pipeline.model) for each in light])


def _sensor_of_stream(stream: Stream, sensor: SensorName) -> Sensor:
    return stream.sensor if str(sensor) == AUTO else load_sensor(sensor)


def _watched(watcher: Watcher, timeout_s: float | None) -> Iterator[FrameResult]:
    one_thread = OneBlasThread()

    def step(wait_s: float) -> Result | None:
        with one_thread:
            return watcher.step(wait_s)

    for result in watcher.stream.each(step, timeout_s):
        yield FrameResult(result, watcher.pipeline.model)
