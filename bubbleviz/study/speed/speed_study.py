"""Run time by stage, its growth with nodes and pixels, memory, and the moving press."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bubbleviz.frames.frame import Frame
from bubbleviz.frames.recording import Recording
from bubbleviz.frames.recording_writer import RecordingWriter
from bubbleviz.frames.sensor_matching import fitting_sensor
from bubbleviz.inverse.solvers.inverse_solver import LINEAR, RUBBER
from bubbleviz.processes.worker_process import MEMORY_LIMIT_BYTES, WorkerProcess
from bubbleviz.result import Result
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import (
    FINER,
    SyntheticSource,
    default_path,
    default_press,
    dome_size,
)
from bubbleviz.study.accuracy.accuracy_study import PRODUCTS, Setup, with_nodes
from bubbleviz.study.error_metrics import iou
from bubbleviz.study.speed.stopwatch import PeakMemory, Stopwatch

SOURCE_NODES = 1_000
"""The simulated press has four times as many, whatever the estimator has."""
ROUND = 150
"""Frames of the moving press."""
BASELINE_FRAMES = 12  # the slow solvers take seconds for each
TYPICAL_PRESTRETCH = 1.2
"""λ where the sensor file has none: by the areas of a bulged dome and the plane in its rim."""


@dataclass(frozen=True)
class Run:
    """One measurement.

    Attributes
    ----------
    sweep : {"stream", "baseline", "nodes", "pixels", "contact", "recording"}
        "contact" is a ball on the exact membrane, "recording" the frames with contact of a file.
    setup : Setup
    pixels : int or None
        Number of pixels of a scaled camera; None for the sensor's own.
    frames : int
        Of the moving press; from its start, or from full depth where they are few.
    limit_s : float
    recording : Path or None
    """

    sweep: str
    setup: Setup = field(default_factory=Setup)
    pixels: int | None = None
    frames: int = 10
    limit_s: float = 120.0
    recording: Path | None = None


@dataclass(frozen=True)
class SpeedRow:
    """What a run found. Times of a stage are medians over the warm frames.

    `total_*` is depth image in → patch pixels out; `other_ms` what no stage accounts for;
    `memory_peak_bytes` the increase of the peak while building and running the estimator.
    """

    sweep: str
    setup: str
    solver: str
    nodes: int
    pixels: int
    frames: int
    error: str = ""
    build_ms: float = np.nan
    cold_ms: float = np.nan
    total_ms: float = np.nan
    total_p95_ms: float = np.nan
    observe_ms: float = np.nan
    linearise_ms: float = np.nan
    assemble_ms: float = np.nan
    solve_ms: float = np.nan
    patch_ms: float = np.nan
    other_ms: float = np.nan
    memory_peak_bytes: int = 0
    iou_mean: float = np.nan
    force_error_relative_median: float = np.nan


def full_runs() -> list[Run]:
    """Streams of every solver, the baseline, nodes 200 … 20,000 and pixels 5k … 1M."""
    streams = [
        Run("stream", Setup(), frames=ROUND),
        Run("stream", Setup(relinearisations=0), frames=ROUND),
        Run("stream", Setup("osqp"), frames=40),
        Run("stream", Setup("clarabel"), frames=BASELINE_FRAMES),
        *baseline_runs(BASELINE_FRAMES, (1e-3, 1e-4, 1e-5, 1e-6)),
    ]
    sizes_n = (200, 500, 1_000, 2_000, 5_000, 10_000, 20_000)
    nodes = [
        *(Run("nodes", Setup(None, n), frames=8) for n in sizes_n),
        *(Run("nodes", Setup("osqp", n), frames=8, limit_s=60.0) for n in sizes_n[:5]),
    ]
    sizes = (5_000, 20_000, 38_304, 150_000, 500_000, 1_000_000)
    return [*streams, *nodes, *(Run("pixels", Setup(), p, limit_s=300.0) for p in sizes)]


def baseline_runs(frames: int, tolerances: tuple[float, ...]) -> list[Run]:
    """The default and `osqp-cold` on the same few frames, the latter to several tolerances."""
    cold = [Setup("osqp-cold", relinearisations=0, tolerance=eps) for eps in tolerances]
    recast = [Setup("osqp-cold", tolerance=eps) for eps in tolerances]
    return [Run("baseline", setup, frames=frames) for setup in (Setup(), *cold, *recast)]


def contact_runs(recording: Path | None, frames: int) -> list[Run]:
    """The exact membrane and the linear one in contact, simulated and, where there is one, real."""
    setups = [Setup(RUBBER), Setup(LINEAR)]
    runs = [Run("contact", setup, frames=frames, limit_s=300.0) for setup in setups]
    if recording is not None:
        real = [Run("recording", s, limit_s=300.0, recording=recording) for s in setups]
        runs += real
    return runs


def quick_runs() -> list[Run]:
    """A subset that runs in less than a minute."""
    return [
        Run("stream", Setup(), frames=40),
        *baseline_runs(6, (1e-3, 1e-5)),
        *(Run("nodes", Setup(None, n), frames=4) for n in (800, 5_000)),
        *(Run("pixels", Setup(), p, frames=4) for p in (38_304, 300_000)),
    ]


def run_speed(
    sensor: Sensor, runs: list[Run], tick: Callable[[SpeedRow], None] = lambda _: None
) -> list[SpeedRow]:
    """Make every measurement in a process of its own; one that breaks says why."""
    rows = []
    for run in runs:
        with WorkerProcess(MEMORY_LIMIT_BYTES) as worker:
            outcome = worker.call(measure, sensor, run, limit_s=run.limit_s)
        row: SpeedRow = outcome.value
        if outcome.kind != "returned":
            row = _empty(sensor, run, f"{outcome.kind}: {outcome.detail}")
        rows.append(row)
        tick(row)
    return rows


def measure(sensor: Sensor, run: Run) -> SpeedRow:
    """Stream a press through one pipeline."""
    if run.recording is not None:
        with Recording(run.recording) as recording:
            _, sensor = fitting_sensor(recording, None)
            frames = [recording[k] for k in range(len(recording))]
            model = SensorModel.of(stretched(sensor), recording.intrinsics)
            return _measured(run, model, frames, None, [])
    scaled = scaled_camera(sensor, run.pixels)
    if run.sweep == "contact":
        scaled = stretched(scaled)
        source = _ball_on_rubber(scaled)
    else:
        source = default_press(with_nodes(scaled, SOURCE_NODES), ROUND)
    order = _frames_of(run, source)
    frames = [replace(source[k], gas_pressure_pa=None) for k in order]
    return _measured(run, SensorModel.of(scaled), frames, source, order)


def stretched(sensor: Sensor) -> Sensor:
    """The sensor with a pre-stretch."""
    stretch = sensor.membrane.prestretch or TYPICAL_PRESTRETCH
    membrane = sensor.membrane.model_copy(update={"prestretch": stretch})
    return sensor.model_copy(update={"membrane": membrane})


def _ball_on_rubber(sensor: Sensor) -> SyntheticSource:
    """A ball along the path of the moving press, on the exact membrane."""
    poses = default_path(*dome_size(sensor), ROUND)
    noise = DepthNoise(relative=sensor.camera.noise_relative)
    return SyntheticSource(sensor, load_object("sphere"), poses, noise, nodes=FINER * SOURCE_NODES)


def _measured(
    run: Run,
    model: SensorModel,
    frames: list[Frame],
    source: SyntheticSource | None,
    order: list[int],
) -> SpeedRow:
    results, laps = [], []
    with PeakMemory() as memory:
        start = time.perf_counter()
        pipeline = run.setup.pipeline_of(model)
        watch = Stopwatch(pipeline.estimator)
        built = 1e3 * (time.perf_counter() - start)
        for frame in frames:
            results.append(pipeline.process(frame, PRODUCTS))
            laps.append(_stages(results[-1], watch))
    warm = laps[1:] or laps
    if run.sweep == "recording":
        touching = [r.estimate is not None and r.estimate.status == "ok" for r in results]
        warm = [lap for lap, ok in zip(laps, touching, strict=True) if ok] or warm
    total = np.array([lap["total_ms"] for lap in warm])
    stages: dict[str, Any] = {k: float(np.median([lap[k] for lap in warm])) for k in warm[0]}
    return SpeedRow(
        **stages,
        **(_quality(results, source, order) if source is not None else {}),
        sweep=run.sweep,
        setup=run.setup.label,
        solver=pipeline.estimator.solver_name,
        nodes=len(pipeline.mesh.nodes),
        pixels=model.sensor.camera.width * model.sensor.camera.height,
        frames=len(warm) if run.sweep == "recording" else len(frames),
        build_ms=built,
        cold_ms=laps[0]["total_ms"],
        total_p95_ms=float(np.percentile(total, 95)),
        memory_peak_bytes=memory.increase_bytes,
    )


def scaled_camera(sensor: Sensor, pixels: int | None) -> Sensor:
    """Sensor whose camera sees the same with about as many pixels as asked."""
    if pixels is None:
        return sensor
    own = sensor.camera
    factor = np.sqrt(pixels / (own.width * own.height))
    width, height = round(factor * own.width), round(factor * own.height)
    x, y = width / own.width, height / own.height
    camera = own.model_copy(
        update={
            "width": width,
            "height": height,
            "fx": own.fx * x,
            "fy": own.fy * y,
            "cx": (own.cx + 0.5) * x - 0.5,
            "cy": (own.cy + 0.5) * y - 0.5,
        }
    )
    return sensor.model_copy(update={"camera": camera})


def read_ms(sensor: Sensor, frames: int = 20) -> float:
    """Median time to read a frame of a recording of this camera."""
    source = default_press(with_nodes(sensor, 200), ROUND)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "press.mcap"
        with RecordingWriter(path) as writer:
            for index in range(frames):
                writer.write(source[index])
        times = []
        with Recording(path) as recording:
            for index in range(frames):
                start = time.perf_counter()
                _touch(recording[index])
                times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))


def _touch(frame: Frame) -> float:
    return float(frame.depth_m[0, 0])


def _frames_of(run: Run, source: SyntheticSource) -> list[int]:
    if run.frames >= len(source):
        return list(range(len(source)))
    deepest = round(0.4 * len(source))
    if run.sweep in ("stream", "baseline", "contact"):
        start = max(0, deepest - run.frames // 2)
        return list(range(start, min(start + run.frames, len(source))))
    return list(range(deepest, deepest + run.frames))


def _stages(result: Result, watch: Stopwatch) -> dict[str, float]:
    lap, times = watch.lap(), result.times_ms
    stages = {f"{name}_ms": lap.get(name, 0.0) for name in ("observe", "linearise", "assemble")}
    own = 0.0 if result.estimate is None else result.estimate.solve_ms
    stages["solve_ms"] = lap.get("solve", own)
    stages["patch_ms"] = times.get("patch", 0.0) + times.get("pixel_mask", 0.0)
    rest = times["total"] - sum(stages.values())
    return {**stages, "other_ms": rest, "total_ms": times["total"]}


def _quality(results: list[Result], source: SyntheticSource, order: list[int]) -> dict[str, Any]:
    """Mean IoU and median force error over the frames with contact."""
    overlaps, errors = [], []
    for result, index in zip(results, order, strict=True):
        truth = source.truth(index)
        if truth.patch_mask.any() and result.patch and result.patch.pixel_mask is not None:
            overlaps.append(iou(result.patch.pixel_mask, truth.patch_mask))
            off = np.linalg.norm(result.patch.force_n - truth.force_n)
            errors.append(off / np.linalg.norm(truth.force_n))
    if not overlaps:
        return {}
    return {
        "iou_mean": float(np.mean(overlaps)),
        "force_error_relative_median": float(np.median(errors)),
    }


def _empty(sensor: Sensor, run: Run, error: str) -> SpeedRow:
    camera = scaled_camera(sensor, run.pixels).camera
    return SpeedRow(
        sweep=run.sweep,
        setup=run.setup.label,
        solver=run.setup.solver or "default",
        nodes=run.setup.nodes or sensor.membrane.nodes,
        pixels=camera.width * camera.height,
        frames=0,
        error=error,
    )
