"""Study of force and patch error against run time: exact, linear and the paper's estimator.

Presses of simulated membranes at two noises.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bubbleviz.files import create_folder
from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import MembraneMesh, TriangleScene
from bubbleviz.output import iou
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    GRID_OBJECTS,
    HELD_OUT_OBJECTS,
    LINEAR_NODES,
    SMOOTH_OBJECTS,
    TRUTH_NODES,
    DepthNoise,
    LinearPresses,
    Model,
    Presses,
    RubberPresses,
    SimulatedPress,
    TruthBank,
    dome,
    noise_name,
    presses,
    rubber_sensor,
    strided,
    with_nodes,
    with_noise,
)
from bubbleviz.study.harness import (
    Case,
    Column,
    Record,
    Report,
    Study,
    Table,
    Target,
    at_least,
    at_most,
    averages,
    groups,
    over,
    summaries,
)

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})
SHALLOWEST_SHARE = 0.2
"""Of the dome's height: patches of shallower presses are as small as the mesh, and not judged."""
FORCE_TARGETS = {"known": (0.02, 0.05), "identified": (0.03, 0.06)}
"""Of the force error, median and worst, where the material is known and identified."""
LEAST_IOU = 0.75


@dataclass(frozen=True)
class Setup:
    """Settings of an estimator; None is what the sensor file and the defaults say."""

    solver: str | None = None
    nodes: int | None = None
    stride: int = 1  # every stride-th pixel of every stride-th row

    @property
    def label(self) -> str:
        """Short name, usable as a file name."""
        parts = [
            self.solver or "default",
            f"n{self.nodes}" if self.nodes else "",
            f"stride{self.stride}" if self.stride > 1 else "",
        ]
        return "_".join(filter(None, parts))

    def pipeline(self, model: SensorModel) -> Pipeline:
        """Pipeline of a sensor whose mesh stays, where no other is asked for."""
        options = EstimatorOptions.named(self.solver)
        if self.nodes is not None or self.stride > 1:
            varied = strided(with_nodes(model.sensor, self.nodes), self.stride)
            return Pipeline.of(varied, options=options)
        return Pipeline(model, options)


RUBBER, LINEAR = Setup("rubber"), Setup("linear")
PAPER = Setup("paper")
"""Eq. 23 by OSQP from rest in every frame, linearised once at the reference surface."""


@dataclass(frozen=True)
class Specimen:
    """A membrane under test: its truth, and what the estimator is told of it at some noise."""

    name: str
    presses: Presses
    told: Callable[[DepthNoise], SensorModel]
    material: str = "known"  # or "identified": found from inflation levels, with none given


@dataclass(frozen=True)
class Grid:
    """What an accuracy study runs over.

    The setups are compared with the first; on membranes other than `sensor`, those of another mesh
    or image are left out.
    """

    specimens: tuple[str, ...] = ("sensor", "dome λ 1.05", "dome λ 1.2", "dome λ 1.5")
    objects: tuple[str, ...] = GRID_OBJECTS + HELD_OUT_OBJECTS  # pressed into `sensor`
    others_objects: tuple[str, ...] = SMOOTH_OBJECTS  # into every other membrane
    depths: tuple[float, ...] = (0.1, 0.2, 0.3, 0.45)  # shares of the dome's height
    noises: tuple[DepthNoise, ...] = (DepthNoise(absolute_m=1e-4), DepthNoise(relative=0.01))
    setups: tuple[Setup, ...] = (RUBBER, LINEAR, PAPER)
    repeats: int = 3  # warm frames of each press, the same but for their noise
    model: Model = "rubber"  # of the truth
    truth_nodes: int = TRUTH_NODES
    limit_s: float | None = 120.0  # wall time of one truth
    seed: int = 7


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one frame; NaN where there is no answer."""

    iou: float = np.nan  # of the patch's pixels
    force_error_relative: float = np.nan  # length of the difference of the vectors
    force_excess_relative: float = np.nan  # |F| over the true one, less 1
    area_error_relative: float = np.nan  # counted on the reference surface
    cop_error_m: float = np.nan  # between centres of pressure
    displacement_rms_m: float = np.nan  # over the estimator's nodes
    gas_error_pa: float = np.nan  # of p_v


@dataclass(frozen=True, kw_only=True)
class Row(Errors):
    """One press at one noise level with one setup: means over the warm frames that have an answer.

    `failed` counts those that have none, and `status` says why; `warm_ms` is the median time from
    depth image in to patch pixels out; `cold_ms` that of the first frame of the press.
    """

    specimen: str
    material: str
    object_name: str
    held_out: bool
    depth_m: float
    depth_share: float
    noise: str
    setup: str
    force_n: float
    nodes: int = 0
    status: str = "ok"
    failed: int = 0
    kkt_residual: float = np.nan
    cold_ms: float = np.nan
    warm_ms: float = np.nan


def full_grid(model: Model = "rubber") -> Grid:
    """All membranes; on the sensor's also other meshes and images."""
    sizes = [replace(s, nodes=n) for s in (RUBBER, LINEAR, PAPER) for n in (400, 800, 1600)]
    if model == "linear":
        setups = (LINEAR, PAPER, *(s for s in sizes if s.solver != "rubber"))
        return Grid(("sensor",), setups=setups, model=model, truth_nodes=LINEAR_NODES, limit_s=None)
    strides = [Setup("rubber", stride=k) for k in (2, 4)]
    return Grid(setups=(RUBBER, LINEAR, PAPER, *sizes, *strides))


def quick_grid(model: Model = "rubber") -> Grid:
    """A subset that runs in about a minute."""
    full = full_grid(model)
    return replace(
        full,
        specimens=("sensor",) if model == "linear" else ("sensor", "dome λ 1.2"),
        objects=("sphere", "puck"),
        others_objects=("sphere",),
        depths=(0.2,),
        noises=full.noises[:1],
        setups=(*full.setups[:3], replace(full.setups[0], nodes=400)),
        repeats=2,
    )


def specimen(name: str, sensor: Sensor, grid: Grid) -> Specimen:
    """One of a grid; `sensor` is of rubber with the usual λ where its file gives none."""
    kind, _, stretch = name.partition(" λ ")
    own = dome(float(stretch)) if kind == "dome" else sensor
    if grid.model == "linear":
        known = SensorModel.of(own)
        return Specimen(name, LinearPresses.of(known, grid.truth_nodes), partial(with_noise, known))
    known = SensorModel.of(rubber_sensor(own))
    return Specimen(name, RubberPresses.of(known, grid.truth_nodes), partial(with_noise, known))


def accuracy_study(
    sensor: Sensor,
    grid: Grid,
    parts: Path | None = None,
    specimen_of: Callable[[str, Sensor, Grid], Specimen] = specimen,
) -> Study:
    """Study of a grid, on its membranes as `specimen_of` makes them."""
    settings = {"grid": asdict(grid), "sensor": sensor.model_dump(mode="json")}
    benches = [Bench(specimen_of(name, sensor, grid), grid, parts) for name in grid.specimens]
    cases = [case for bench in benches for case in bench.cases()]
    return Study("accuracy", Row, cases, partial(report_of, grid), settings=settings, parts=parts)


class Bench:
    """Truths and pipelines of one membrane."""

    def __init__(self, own: Specimen, grid: Grid, parts: Path | None) -> None:
        folder = None
        if parts is not None:
            folder = create_folder(parts / f"{own.name.replace(' ', '_')}_truth")
        self._own, self._grid = own, grid
        self.bank = TruthBank(own.presses, grid.seed, folder, grid.limit_s)
        self.height_m = float(self.bank.mesh.nodes[:, 2].max())
        self.sightings: list[SimulatedPress] = []

    def cases(self) -> list[Case]:
        """Every press, then every setup at every noise."""
        grid, own = self._grid, self._own.name == "sensor"
        work: dict[str, Callable[[], list[Row]]] = {}
        for obj, share in product(grid.objects if own else grid.others_objects, grid.depths):
            work[f"{obj} at {100 * share:g} %"] = partial(self._press, obj, share)
        for noise, setup in product(grid.noises, grid.setups):
            if own or (setup.nodes is None and setup.stride == 1):
                run = partial(self._rows, setup, noise)
                work[f"{setup.label}, {noise_name(noise)}"] = run
        return [Case(f"{self._own.name}, {name}", run) for name, run in work.items()]

    def _press(self, obj: str, share: float) -> list[Row]:
        """Find a truth, of which the cases after this make rows."""
        (press,) = presses((obj,), (share * self.height_m,))
        self.sightings.append(self.bank.simulate(press))
        return []

    def _rows(self, setup: Setup, noise: DepthNoise) -> list[Row]:
        pipeline = setup.pipeline(self._own.told(noise))
        return [self._row(sighting, noise, setup, pipeline) for sighting in self.sightings]

    def _row(
        self, sighting: SimulatedPress, noise: DepthNoise, setup: Setup, pipeline: Pipeline
    ) -> Row:
        frames = (
            self.bank.frame(sighting, noise, k, setup.stride) for k in range(self._grid.repeats + 1)
        )
        pipeline.restart()
        cold, *warm = (pipeline.process(frame, PRODUCTS) for frame in frames)
        answered = [r for r in warm if r.estimate is not None and r.estimate.status == "ok"]
        errors = [errors_of(pipeline, result, sighting, setup.stride) for result in answered]
        means: dict[str, Any] = {f.name: over(errors, f.name, np.mean) for f in fields(Errors)}
        statuses = [r.estimate.status for r in warm if r.estimate is not None]
        residuals = [r.estimate.kkt_residual for r in answered if r.estimate is not None]
        press = sighting.press
        return Row(
            **means,
            specimen=self._own.name,
            material=self._own.material,
            object_name=press.object_name,
            held_out=press.held_out,
            depth_m=press.depth_m,
            depth_share=round(press.depth_m / self.height_m, 6),
            noise=noise_name(noise),
            setup=setup.label,
            force_n=float(np.linalg.norm(sighting.truth.force_n)),
            nodes=len(pipeline.mesh.nodes),
            status=next((s for s in statuses if s != "ok"), "ok"),
            failed=len(warm) - len(answered),
            kkt_residual=max(residuals, default=np.nan),
            cold_ms=cold.times_ms["total"],
            warm_ms=float(np.median([result.times_ms["total"] for result in warm])),
        )


def errors_of(
    pipeline: Pipeline, result: Result, sighting: SimulatedPress, stride: int = 1
) -> Errors:
    """Errors of a pipeline's result with an estimate, a patch and its pixels.

    The truth is on another mesh of the same surface; the pixels are every stride-th of its image.
    """
    estimate, patch, truth = result.estimate, result.patch, sighting.truth
    if estimate is None or patch is None or patch.pixel_mask is None:
        raise ValueError("the result lacks the estimate, the patch or its pixels")
    expected = at_nodes(pipeline.mesh, sighting.mesh, truth.displacement_m)
    force = float(np.linalg.norm(truth.force_n))
    away = patch.center_of_pressure_m - truth.center_of_pressure_m
    return Errors(
        iou=iou(patch.pixel_mask, truth.patch_mask[::stride, ::stride]),
        force_error_relative=truth.force_error(patch.force_n),
        force_excess_relative=float(np.linalg.norm(patch.force_n)) / force - 1.0,
        area_error_relative=patch.area_m2 / truth.patch_area_m2 - 1.0,
        cop_error_m=float(np.linalg.norm(away)),
        displacement_rms_m=float(np.sqrt(np.mean((estimate.displacement_m - expected) ** 2))),
        gas_error_pa=abs(estimate.gas_pressure_change_pa - truth.gas_pressure_change_pa),
    )


def at_nodes(mesh: MembraneMesh, other: MembraneMesh, field: np.ndarray) -> np.ndarray:
    """Field (m, …) of the nodes of another mesh of the same surface, at those of a mesh, (n, …)."""
    found = TriangleScene(other.nodes, other.triangles).closest(mesh.nodes)
    corners = field[other.triangles[found.triangle]]
    values: np.ndarray = np.einsum("ij...,ij->i...", corners, found.barycentric)
    return values


ERROR = "force_error_relative"
AVERAGES = averages(
    *(ERROR, "force_excess_relative", "area_error_relative", "cop_error_m", "displacement_rms_m"),
    *("gas_error_pa", "warm_ms", "cold_ms"),
) | {
    "worst": (ERROR, np.max),
    "iou": ("iou", np.mean),
    "failed": ("failed", np.count_nonzero),
}
"""Medians, but for the patch's mean IoU, the worst force and the presses with failed frames."""


def curves(rows: list[Row]) -> list[Record]:
    """Errors over depth, by setup and by how the material is known; one mesh and image."""
    some = [r for r in rows if r.setup in {s.label for s in (RUBBER, LINEAR, PAPER)}]
    some.sort(key=lambda row: row.depth_share)
    found = summaries(some, ("material", "setup", "depth_share"), AVERAGES)
    return sorted(
        found, key=lambda c: (c["material"] == "identified", c["setup"] != RUBBER.label, c["setup"])
    )


def points(rows: list[Row]) -> list[Record]:
    """Every setup on the plane of error and run time: presses into one membrane at one noise.

    `on_front` says that no other setup is both faster and better, in IoU or in force.
    """
    deep = [row for row in rows if not row.held_out and row.depth_share >= SHALLOWEST_SHARE]
    found = summaries(deep, ("specimen", "noise", "setup", "nodes"), AVERAGES)
    return [{**point, "on_front": _on_front(point, found)} for point in found]


def _on_front(point: Record, found: list[Record]) -> bool:
    same = [p for p in found if all(p[by] == point[by] for by in ("specimen", "noise"))]
    others = [p for p in same if p["warm_ms"] <= point["warm_ms"]]
    better = any(p["iou"] > point["iou"] for p in others)
    nearer = any(p[ERROR] < point[ERROR] for p in others)
    return not (better and nearer)


def targets(rows: list[Row], label: str) -> list[Target]:
    """Targets of a setup, and whether each is met."""
    found = list[Target]()
    own = [row for row in rows if row.setup == label]
    for (material, noise), some in groups(own, "material", "noise").items():
        median, worst = FORCE_TARGETS[material]
        name, answered = f"{material}, {noise}", [r for r in some if np.isfinite(r.iou)]
        deep = [row for row in answered if row.depth_share >= SHALLOWEST_SHARE]
        if answered:
            found += [
                at_most(f"{name}: median force error", over(answered, ERROR), median),
                at_most(f"{name}: worst force error", over(answered, ERROR, np.max), worst),
            ]
        found.append(at_most(f"{name}: presses without an answer", len(some) - len(answered), 0))
        if deep:
            found.append(at_least(f"{name}: mean patch IoU", over(deep, "iou", np.mean), LEAST_IOU))
    return found


_ERRORS = (
    Column("presses", "count"),
    Column("failed", "failed", ".0f"),
    Column("force err %", ERROR, ".2f", 100),
    Column("worst %", "worst", ".1f", 100),
    Column("excess %", "force_excess_relative", "+.1f", 100),
    Column("IoU", "iou", ".3f"),
    Column("area err %", "area_error_relative", "+.0f", 100),
    Column("ms", "warm_ms", ".1f"),
)
_CURVE = (
    *(Column(name, name) for name in ("material", "setup")),
    Column("depth %", "depth_share", "g", 100),
    *_ERRORS,
)
_POINT = (
    *(Column(name, name) for name in ("specimen", "noise", "setup", "nodes")),
    *_ERRORS,
    Column("cold ms", "cold_ms", ".0f"),
    Column("CoP mm", "cop_error_m", ".2f", 1e3),
    Column("rms u mm", "displacement_rms_m", ".3f", 1e3),
    Column("p_v err Pa", "gas_error_pa", ".1f"),
    Column("front", "on_front"),
)


def report_of(grid: Grid, rows: list[Row]) -> Report:
    """Tables over depth, of every setup, and by object."""
    label = grid.setups[0].label
    own = [row for row in rows if row.setup == label]
    by = "specimen", "object_name", "noise"
    press = (*(Column(name, name) for name in by), *_ERRORS)
    title = f"Force error over press depth, all membranes and noises; truth: {grid.model} membrane"
    time = f"Run time, from {100 * SHALLOWEST_SHARE:g} % of the height; front: Pareto front"
    tables = [
        Table("curves", curves(rows), _CURVE, title),
        Table("points", points(rows), _POINT, time),
        Table("objects", summaries(own, by, AVERAGES), press, f"{label} by object"),
    ]
    numbers = {"grid": asdict(grid)}
    return Report(tables, targets(rows, label), numbers, plot=partial(plot, rows))


def plot(rows: list[Row], figure: Figure) -> None:
    """Patch and force on the first membrane over run time, at the last noise."""
    own = [row for row in rows if row.specimen == rows[0].specimen and row.noise == rows[-1].noise]
    found = sorted(points(own), key=lambda p: p["warm_ms"])
    scale = "log" if found else "linear"
    iou_axes, force_axes = figure.subplots(1, 2)
    for axes, name, best in ((iou_axes, "iou", np.maximum), (force_axes, ERROR, np.minimum)):
        for solver in dict.fromkeys(p["setup"].split("_")[0] for p in found):
            some = [p for p in found if p["setup"].split("_")[0] == solver]
            axes.scatter([p["warm_ms"] for p in some], [p[name] for p in some], s=24, label=solver)
        front = best.accumulate([p[name] for p in found])
        axes.step([p["warm_ms"] for p in found], front, "k", where="post", label="Pareto front")
        axes.set(xlabel="run time of a warm frame, ms (median)", xscale=scale)
    figure.suptitle(f"{rows[0].specimen}, noise {rows[-1].noise}")
    iou_axes.set(ylabel="mean patch IoU")
    force_axes.set(ylabel="median relative force error", yscale=scale)
