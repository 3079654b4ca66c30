"""Run time of every stage of a frame, the machine's lower bound, and growth with size.

The lower bound counts the memory traffic that a stage needs at least, at the machine's measured
copy rate, and its dense and sparse linear algebra at the measured rate of matrix products.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from bubbleviz.camera import RangeLine
from bubbleviz.inverse import LINEAR, RUBBER, EstimatorOptions
from bubbleviz.membrane import cotangent_laplacian, symmetric_lu
from bubbleviz.output import VtkSeries
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame, Recording, RecordingWriter
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    DepthNoise,
    SyntheticSource,
    default_path,
    dome_size,
    rubber_sensor,
    with_nodes,
    with_pixels,
)
from bubbleviz.study.harness import Case, Report, Study
from bubbleviz.study.speed import FRAMES

_POSES = (0, 25, 35, 45, 51, 54, 57, 60)
"""Frames of the moving press: one above the membrane, and the descent."""
_WARM = 4  # the last of them are measured
_SOLVES = 5
"""Minimum number of solves with the factors of the tangent in a step of the exact membrane:
motion to equilibrium and pull of the ranges, each before and after, and the bulge."""


@dataclass(frozen=True)
class Machine:
    """Peak rates of one core."""

    bytes_per_s: float  # copied, read and written together, of arrays larger than its caches
    flops_per_s: float  # of products of matrices

    @classmethod
    def measured(cls) -> Machine:
        """Measure this machine."""
        source = np.ones(8_000_000)
        target, square = np.empty_like(source), np.ones((400, 400))
        copying = min(_seconds(lambda: np.copyto(target, source)) for _ in range(20))
        multiplying = min(_seconds(lambda: square @ square) for _ in range(20))
        return cls(2.0 * source.nbytes / copying, 2.0 * len(square) ** 3 / multiplying)

    def floor_ms(self, moved_bytes: float, flops: float) -> float:
        """Time for an amount of memory traffic and arithmetic that overlap perfectly, ms."""
        return 1e3 * max(moved_bytes / self.bytes_per_s, flops / self.flops_per_s)


@dataclass(frozen=True)
class StageTime:
    """One line of the table: processor time of a frame, and exponents e of time ∝ sizeᵉ."""

    stage: str
    ms: float  # median over passes
    floor_ms: float
    by_pixels: float
    by_nodes: float


@dataclass(frozen=True)
class StageSizes:
    """Pixels and nodes at which stages are measured; the table shows the first of each."""

    pixels: tuple[int, int] = (307_200, 76_800)
    nodes: tuple[int, int] = (1_000, 2_000)
    passes: int = 15  # over the frames
    source_nodes: int = 1_500  # of the simulated membrane, independent of the estimator's


def stages_study(sensor: Sensor, sizes: StageSizes) -> Study:
    """The table for a ball on the exact membrane of a sensor."""
    machine = Machine.measured()
    case = Case("stages", partial(stage_times, sensor, sizes, machine))

    def report_of(times: Sequence[StageTime]) -> Report:
        numbers = {"machine": asdict(machine), "sizes": asdict(sizes)}
        return Report(numbers=numbers, text=stage_text(times, sizes, machine), rows_name="stages")

    return Study("stages", StageTime, [case], report_of)


def stage_times(sensor: Sensor, sizes: StageSizes, machine: Machine) -> list[StageTime]:
    """Lines of the table."""
    pixels, nodes, rubber = sizes.pixels, sizes.nodes, rubber_sensor(sensor)
    with tempfile.TemporaryDirectory() as folder:
        here, other_camera, other_mesh = (
            _Stages(with_nodes(with_pixels(rubber, p), n), sizes, Path(folder) / f"{p}_{n}")
            for p, n in ((pixels[0], nodes[0]), (pixels[1], nodes[0]), (pixels[0], nodes[1]))
        )
        times = [each.times_ms(sizes.passes) for each in (here, other_camera, other_mesh)]
        floors = here.floors_ms(machine)
    usual, by_camera, by_mesh = times
    return [
        StageTime(
            stage,
            ms,
            floors[stage],
            float(np.log(by_camera[stage] / ms) / np.log(pixels[1] / pixels[0])),
            float(np.log(by_mesh[stage] / ms) / np.log(nodes[1] / nodes[0])),
        )
        for stage, ms in usual.items()
    ]


class _Stages:
    """The stages on frames of one press, each callable separately.

    The folder is created, for a recording and exports.
    """

    def __init__(self, sensor: Sensor, sizes: StageSizes, folder: Path) -> None:
        folder.mkdir()
        self._folder, ball = folder, load_object("sphere")
        poses = default_path(*dome_size(sensor), FRAMES)[list(_POSES)]
        noise = DepthNoise(relative=sensor.camera.noise_relative)
        source = SyntheticSource(sensor, ball, poses, noise, nodes=sizes.source_nodes)
        frames = [replace(source[k], gas_pressure_pa=None) for k in range(len(source))]
        self._path = folder / "press.mcap"
        with RecordingWriter(self._path) as writer:
            for frame in frames:
                writer.write(frame)
        self._model = SensorModel.of(sensor)
        self._free, touching = frames[0], frames[1:]
        self._linear, self._exact = (
            _Solved.of(Pipeline(self._model, EstimatorOptions(solver=name)), touching)
            for name in (LINEAR, RUBBER)
        )
        self._exact.pipeline.track(ball, source.poses[-_WARM])

    def times_ms(self, passes: int) -> dict[str, float]:
        """Median processor time of each stage on a warm frame, ms."""
        with Recording(self._path) as recording:
            calls = self._calls(recording)
            spent: dict[str, list[float]] = {stage: [] for stage in calls}
            for _ in range(passes):
                for stage, call in calls.items():
                    spent[stage] += [_seconds(partial(call, k)) for k in range(_WARM)]
        return {stage: 1e3 * float(np.median(times)) for stage, times in spent.items()}

    def _calls(self, recording: Recording) -> dict[str, Callable[[int], object]]:
        """Function of each stage on a warm frame, by its number."""
        exact, linear, free = self._exact, self._linear, self._free
        observer, view = linear.pipeline.estimator.observer, self._model.view
        expected = np.zeros(observer.blocks)
        ranges = observer.pixel_residuals(free.depth_m)
        line = RangeLine(1.0 + 0.1 * ranges, ranges, ranges - 0.01, ranges + 0.01, 2)
        exporter = VtkSeries(self._folder, "frame", self._model)
        tracker = exact.pipeline.tracker
        assert tracker is not None
        return {
            "decode": lambda k: recording[k].depth_m,
            "straighten": lambda k: line.straighten(ranges),
            "observe": lambda k: observer.observe(free.depth_m, expected),
            "detect": lambda k: linear.pipeline.estimator.estimate(free.depth_m),
            "estimate, linear": linear.estimate,
            "estimate, exact": exact.estimate,
            "patch": lambda k: exact.pipeline.unfiltered_patch(exact.estimates[k]),
            "pixel mask": lambda k: view.above(
                exact.estimates[k].motion_m, exact.patches[k].level, 0.0
            ),
            "pose": lambda k: tracker.update(
                exact.results[k].frame, exact.estimates[k], exact.patches[k]
            ),
            "export": lambda k: exporter.add(exact.results[k]),
        }

    def floors_ms(self, machine: Machine) -> dict[str, float]:
        """Lower bound of each stage, ms; after `times_ms`."""
        model, estimator = self._model, self._linear.pipeline.estimator
        mesh, observer = model.mesh, estimator.observer
        image, used, nodes = self._free.depth_m.size, len(observer.pixel), len(mesh.nodes)
        touching = int(np.count_nonzero(self._exact.estimates[-1].contact_pressure_pa))
        tension = cotangent_laplacian(mesh)[mesh.free][:, mesh.free]
        rubber = model.rubber
        tangent = rubber.tangent(mesh.nodes, rubber.gauge_pressure_pa)
        file = max(self._folder.glob("*.vtp")).stat().st_size
        seen, solve = 12.0 * used, 12.0 * _filled(tension.tocsc())
        exact_solves = 12.0 * _SOLVES * _filled(tangent)
        work = {
            "decode": (8.0 * image, 0.0),
            "straighten": (24.0 * used, 0.0),
            "observe": (seen, 0.0),
            "detect": (seen + solve, 0.0),
            "estimate, linear": (
                seen + 2.0 * solve + 8.0 * nodes * touching,
                touching**3 / 3.0 + 4.0 * nodes * touching,
            ),
            "estimate, exact": (seen + exact_solves, float(touching**2 * observer.blocks)),
            "patch": (16.0 * nodes, 0.0),
            "pixel mask": (float(image), 0.0),
            "pose": (seen, 0.0),
            "export": (2.0 * file, 0.0),
        }
        return {stage: machine.floor_ms(*each) for stage, each in work.items()}


@dataclass(frozen=True)
class _Solved:
    """The warm frames of a press with their results, and the warm start of each."""

    pipeline: Pipeline
    results: list[Result]
    estimates: list[Estimate]
    patches: list[Patch]
    starts: list[Any]

    @classmethod
    def of(cls, pipeline: Pipeline, frames: list[Frame]) -> _Solved:
        """Solve frames one after the other."""
        found, start = list[tuple[Any, ...]](), None
        estimator: Any = pipeline.estimator  # each kind has its own warm start
        for frame in frames:
            estimate, following = estimator.estimate(frame.depth_m, None, start)
            patch = pipeline.patch(estimate, pixel_mask=True)
            result = Result(frame, estimate=estimate, patch=patch)
            found.append((result, estimate, patch, start))
            start = following
        return cls(pipeline, *map(list, zip(*found[-_WARM:], strict=True)))

    def estimate(self, k: int) -> object:
        """Solve number k again."""
        return self.pipeline.estimator.estimate(self.results[k].frame.depth_m, None, self.starts[k])


def _filled(matrix: sparse.csc_array) -> int:
    """Number of nonzeros in the factors of a matrix of symmetric pattern."""
    factors = symmetric_lu(matrix)
    return int(factors.L.nnz + factors.U.nnz)


def _seconds(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start


def stage_text(times: Sequence[StageTime], sizes: StageSizes, machine: Machine) -> str:
    """The table as Markdown, with the machine and sizes."""
    lines = [
        f"| {t.stage} | {t.ms:.2f} | {t.floor_ms:.3f} | {t.ms / t.floor_ms:.0f} "
        f"| {t.by_pixels:.1f} | {t.by_nodes:.1f} |"
        for t in times
    ]
    return "\n".join(
        [
            f"{sizes.pixels[0]} pixels, {sizes.nodes[0]} nodes; processor time, median of "
            f"{_WARM * sizes.passes} frames; one core copies {1e-9 * machine.bytes_per_s:.1f} GB/s "
            f"and multiplies at {1e-9 * machine.flops_per_s:.1f} Gflop/s",
            "",
            "| stage | ms | floor, ms | times the floor | growth with pixels | with nodes |",
            "|---|---|---|---|---|---|",
            *lines,
        ]
    )
