"""Study of run time by stage, its growth with nodes and pixels, and memory, on a moving press."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.inverse import LINEAR, RUBBER
from bubbleviz.processes import PeakMemory
from bubbleviz.recordings import Frame
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    NODE_RATIO,
    SyntheticSource,
    default_press,
    iou,
    rubber_sensor,
    with_nodes,
    with_pixels,
)
from bubbleviz.study.accuracy import PAPER, PRODUCTS, Setup
from bubbleviz.study.harness import (
    Case,
    Column,
    Record,
    Report,
    Study,
    Table,
    Target,
    at_most,
    groups,
)

SOURCE_NODES = 1_000  # the simulation has four times as many, independent of the estimator
FRAMES = 150  # of the moving press
STAGES = ("estimate", "solve", "patch", "other")
"""`estimate` without its solves, and `patch` with its pixels."""
CONTACT_MS = 60.0  # median time in contact for playback at the camera's rate
SMALLEST_FITTED = {"nodes": 800, "pixels": 20_000}


@dataclass(frozen=True)
class Run:
    """One measurement on a moving press.

    The sweep is "stream", "nodes", "pixels" or "contact" (a ball on the exact membrane).
    """

    sweep: str
    setup: Setup = field(default_factory=Setup)
    pixels: int | None = None  # of a scaled camera; None: the sensor's
    frames: int = 10  # a small number is taken at the largest depth
    limit_s: float = 120.0

    @property
    def name(self) -> str:
        """Its sweep, and what differs from the sensor file."""
        pixels = () if self.pixels is None else (f"{self.pixels} pixels",)
        return " ".join((self.sweep, self.setup.label, *pixels))


@dataclass(frozen=True)
class Row:
    """Results of a run. Times of a stage are medians over the warm frames.

    `total_*` is depth image in → patch pixels out; `other_ms` is `total_ms` minus all stages;
    `memory_peak_bytes` the increase of the peak while building and running the estimator.
    """

    sweep: str
    setup: str
    solver: str
    nodes: int
    pixels: int
    frames: int
    build_ms: float = np.nan
    cold_ms: float = np.nan
    total_ms: float = np.nan
    total_p95_ms: float = np.nan
    estimate_ms: float = np.nan
    solve_ms: float = np.nan
    patch_ms: float = np.nan
    other_ms: float = np.nan
    memory_peak_bytes: int = 0
    iou_mean: float = np.nan
    force_error_relative_median: float = np.nan


def full_runs() -> list[Run]:
    """Streams of the solvers, nodes 200 … 20,000 and pixels 5k … 1M."""
    sizes_n = (200, 500, 1_000, 2_000, 5_000, 10_000, 20_000)
    sizes_p = (5_000, 20_000, 38_304, 150_000, 500_000, 1_000_000)
    return [
        Run("stream", frames=FRAMES),
        Run("stream", Setup("linear"), frames=FRAMES),
        Run("stream", PAPER, frames=12),
        *(Run("nodes", Setup(None, n), frames=8) for n in sizes_n),
        *(Run("nodes", Setup("paper", n), frames=8, limit_s=60.0) for n in sizes_n[:5]),
        *(Run("pixels", pixels=p, limit_s=300.0) for p in sizes_p),
    ]


def quick_runs() -> list[Run]:
    """A subset that runs in less than a minute."""
    return [
        Run("stream", frames=40),
        Run("stream", PAPER, frames=6),
        *(Run("nodes", Setup(None, n), frames=4) for n in (800, 5_000)),
        *(Run("pixels", pixels=p, frames=4) for p in (38_304, 300_000)),
    ]


def contact_runs(frames: int) -> list[Run]:
    """Exact and linear membrane in contact."""
    setups = Setup(RUBBER), Setup(LINEAR)
    return [Run("contact", setup, frames=frames, limit_s=300.0) for setup in setups]


def speed_study(sensor: Sensor, runs: list[Run]) -> Study:
    """Run every measurement in a separate process."""
    cases = [Case(run.name, partial(measure, sensor, run), run.limit_s) for run in runs]
    return Study("speed", Row, cases, report_of, fresh=True)


def measure(sensor: Sensor, run: Run) -> list[Row]:
    """Stream a press through one pipeline."""
    scaled = with_pixels(sensor, run.pixels)
    if run.sweep == "contact":  # a ball along the path of the moving press
        scaled = rubber_sensor(scaled)
        nodes = NODE_RATIO * SOURCE_NODES
        source = default_press(scaled, FRAMES, nodes=nodes, object_name="sphere")
    else:
        source = default_press(with_nodes(scaled, SOURCE_NODES), FRAMES)
    order = _frames_of(run, len(source))
    frames = [replace(source[k], gas_pressure_pa=None) for k in order]
    return [_measured(run, SensorModel.of(scaled), frames, source, order)]


def _frames_of(run: Run, count: int) -> list[int]:
    deepest = round(0.4 * count)
    before = run.frames // 2 if run.sweep in ("stream", "contact") else 0
    start = max(0, deepest - before) if run.frames < count else 0
    return list(range(start, min(start + run.frames, count)))


def _measured(
    run: Run,
    model: SensorModel,
    frames: list[Frame],
    source: SyntheticSource,
    order: list[int],
) -> Row:
    results, times = [], []
    with PeakMemory() as memory:
        start = time.perf_counter()
        pipeline = run.setup.pipeline(model)
        built = 1e3 * (time.perf_counter() - start)
        for frame in frames:
            results.append(pipeline.process(frame, PRODUCTS))
            times.append(_stages(results[-1]))
    warm = times[1:] or times
    stages: dict[str, Any] = {k: float(np.median([each[k] for each in warm])) for k in warm[0]}
    return Row(
        **stages,
        **_quality(results, source, order),
        sweep=run.sweep,
        setup=run.setup.label,
        solver=pipeline.estimator.solver_name,
        nodes=len(pipeline.mesh.nodes),
        pixels=model.sensor.camera.width * model.sensor.camera.height,
        frames=len(frames),
        build_ms=built,
        cold_ms=times[0]["total_ms"],
        total_p95_ms=float(np.percentile([each["total_ms"] for each in warm], 95)),
        memory_peak_bytes=memory.increase_bytes,
    )


def _stages(result: Result) -> dict[str, float]:
    times, solve = result.times_ms, 0.0 if result.estimate is None else result.estimate.solve_ms
    stages = {
        "estimate_ms": times["estimate"] - solve,
        "solve_ms": solve,
        "patch_ms": times.get("patch", 0.0) + times.get("pixel_mask", 0.0),
    }
    rest = times["total"] - sum(stages.values())
    return {**stages, "other_ms": rest, "total_ms": times["total"]}


def _quality(results: list[Result], source: SyntheticSource, order: list[int]) -> dict[str, Any]:
    """Mean IoU and median force error over the frames with contact."""
    overlaps, errors = [], []
    for result, index in zip(results, order, strict=True):
        truth = source.truth(index)
        if truth.patch_mask.any() and result.patch and result.patch.pixel_mask is not None:
            overlaps.append(iou(result.patch.pixel_mask, truth.patch_mask))
            errors.append(truth.force_error(result.patch.force_n))
    if not overlaps:
        return {}
    return {
        "iou_mean": float(np.mean(overlaps)),
        "force_error_relative_median": float(np.median(errors)),
    }


def growths(rows: list[Row]) -> list[Record]:
    """Exponents e of time and memory ∝ size^e, fitted to the larger sizes of every sweep."""
    found = list[Record]()
    for (sweep, solver), own in _sweeps(rows).items():
        own = [row for row in own if getattr(row, sweep) >= 0.9 * SMALLEST_FITTED[sweep]]
        if len(own) >= 2:
            sizes = np.log([getattr(row, sweep) for row in own])
            record: Record = {"sweep": sweep, "solver": solver, "sizes": len(own)}
            for name, field_name in (("time", "total_ms"), ("memory", "memory_peak_bytes")):
                values = [max(getattr(row, field_name), 1e-9) for row in own]
                record[f"{name}_exponent"] = float(np.polyfit(sizes, np.log(values), 1)[0])
            found.append(record)
    return found


def _sweeps(rows: list[Row]) -> dict[tuple[str, str], list[Row]]:
    """Rows of each sweep over sizes, by solver."""
    return groups((r for r in rows if r.sweep in SMALLEST_FITTED), "sweep", "solver")


def targets(rows: list[Row]) -> list[Target]:
    """Targets, and whether each is met in this run."""
    found = list[Target]()
    for row in rows:
        if (row.sweep, row.setup) == ("stream", "default"):
            found.append(at_most("stream, median ms", row.total_ms, 8.0))
            found.append(at_most("stream, p95 ms", row.total_p95_ms, 16.0))
        if row.sweep == "contact" and row.solver == RUBBER:
            found.append(at_most("contact, exact membrane, median ms", row.total_ms, CONTACT_MS))
    for growth in growths(rows):
        if growth["sweep"] == "nodes":
            name = f"{growth['solver']}, exponent in nodes"
            found.append(at_most(name, growth["time_exponent"], 1.6))
    images = [row for row in rows if row.sweep == "pixels"]
    small = [row.total_ms for row in images if 30_000 < row.pixels < 50_000]
    large = [row.total_ms for row in images if row.pixels > 900_000]
    if small and large:
        found.append(at_most("1M pixels over 38k", large[0] / small[0], 10.0))
    return found


_COLUMNS = (
    *(Column(name, name) for name in ("sweep", "setup", "nodes", "pixels")),
    Column("build ms", "build_ms", ".1f"),
    Column("cold ms", "cold_ms", ".1f"),
    Column("median ms", "total_ms", ".1f"),
    Column("p95 ms", "total_p95_ms", ".1f"),
    *(Column(f"{name} ms", f"{name}_ms", ".1f") for name in STAGES),
    Column("memory MiB", "memory_peak_bytes", ".0f", 2.0**-20),
    Column("IoU", "iou_mean", ".3f"),
    Column("force err %", "force_error_relative_median", ".2f", 100),
)
_GROWTH = (
    *(Column(name, name) for name in ("sweep", "solver", "sizes")),
    Column("of time", "time_exponent", ".2f"),
    Column("of memory", "memory_exponent", ".2f"),
)


def report_of(rows: list[Row]) -> Report:
    """Times of every run, their growth, and targets."""
    tables = [
        Table("growth", growths(rows), _GROWTH, "Exponents of growth with size"),
        Table("runs", [asdict(row) for row in rows], _COLUMNS),
    ]
    return Report(tables, targets(rows), plot=partial(plot, rows))


def plot(rows: list[Row], figure: Figure) -> None:
    """Growth with nodes and with pixels."""
    for axes, sweep in zip(figure.subplots(1, 2), SMALLEST_FITTED, strict=True):
        for (name, solver), own in _sweeps(rows).items():
            if name == sweep:
                sizes = [getattr(row, sweep) for row in own]
                axes.loglog(sizes, [row.total_ms for row in own], "o-", label=f"{solver}, warm")
                axes.loglog(sizes, [row.cold_ms for row in own], "x:", label=f"{solver}, cold")
        axes.set(xlabel=sweep, ylabel="ms", title=f"Growth with {sweep}")
