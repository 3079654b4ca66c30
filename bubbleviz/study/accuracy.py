"""Study of force and patch error against run time: exact, linear and the paper's estimator.

On simulated presses at two noise levels.
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
    Press,
    Presses,
    RubberPresses,
    SimulatedPress,
    TruthBank,
    dome,
    iou,
    noise_name,
    presses,
    rubber_sensor,
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
from bubbleviz.zeros import Zeros, zeros_of

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})
MIN_DEPTH_SHARE = 0.2
"""Of the dome's height: patches of shallower presses are as small as the mesh, and not rated."""
FORCE_TARGETS = {"known": (0.02, 0.05), "identified": (0.03, 0.06)}
"""Median and worst relative force error, for known and identified material."""
MIN_IOU = 0.75


@dataclass(frozen=True)
class Setup:
    """Settings of an estimator; None: from the sensor file or default."""

    solver: str | None = None
    nodes: int | None = None

    @property
    def label(self) -> str:
        """Short name, usable as a file name."""
        own = self.solver or "default"
        return f"{own}_n{self.nodes}" if self.nodes else own

    def pipeline(self, model: SensorModel) -> Pipeline:
        """Pipeline of a sensor; on its own mesh unless `nodes` differ."""
        options = EstimatorOptions.named(self.solver)
        if self.nodes is not None:
            return Pipeline.of(with_nodes(model.sensor, self.nodes), options=options)
        return Pipeline(model, options)


RUBBER, LINEAR = Setup("rubber"), Setup("linear")
PAPER = Setup("paper")
"""Eq. 23 by OSQP, cold-started in every frame, linearised once at the reference surface."""


@dataclass(frozen=True)
class Specimen:
    """A membrane under test: its simulated presses, and the estimator's model at a given noise."""

    name: str
    presses: Presses
    model: Callable[[DepthNoise], SensorModel]
    material: str = "known"  # or "identified" from inflation levels


@dataclass(frozen=True)
class Grid:
    """Parameters of an accuracy study.

    The first setup is the reference. Setups with another mesh run on `sensor` alone.
    """

    specimens: tuple[str, ...] = ("sensor", "dome λ 1.05", "dome λ 1.2", "dome λ 1.5")
    objects: tuple[str, ...] = GRID_OBJECTS + HELD_OUT_OBJECTS  # pressed into `sensor`
    others_objects: tuple[str, ...] = SMOOTH_OBJECTS  # pressed into other membranes
    depths: tuple[float, ...] = (0.1, 0.2, 0.3, 0.45)  # over the dome's height
    noises: tuple[DepthNoise, ...] = (DepthNoise(absolute_m=1e-4), DepthNoise(relative=0.01))
    setups: tuple[Setup, ...] = (RUBBER, LINEAR, PAPER)
    repeats: int = 3  # warm frames of each press, with different noise
    model: Model = "rubber"  # of the ground truth
    truth_nodes: int = TRUTH_NODES
    limit_s: float | None = 120.0  # wall time of one press of the ground truth
    seed: int = 7


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one frame; NaN without trusted estimate."""

    iou: float = np.nan  # of the patch's pixels
    force_error_relative: float = np.nan  # |difference of the forces| over |true force|
    force_excess_relative: float = np.nan  # |F| over the true one, minus 1
    area_error_relative: float = np.nan  # on the reference surface
    cop_error_m: float = np.nan  # distance between centres of pressure
    displacement_rms_m: float = np.nan  # over the estimator's nodes
    gas_error_pa: float = np.nan  # of p_v


@dataclass(frozen=True, kw_only=True)
class Row(Errors):
    """One press at one noise level with one setup: means over the warm frames of status ok.

    `failed` counts the other frames, and `status` is one of theirs; `warm_ms` is the median time
    from depth image in to patch pixels out, `cold_ms` that of the first frame of the press.
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
    """All membranes; for `sensor` also other meshes."""
    sizes = [replace(s, nodes=n) for s in (RUBBER, LINEAR, PAPER) for n in (400, 800, 1600)]
    if model == "linear":
        setups = (LINEAR, PAPER, *(s for s in sizes if s.solver != "rubber"))
        return Grid(("sensor",), setups=setups, model=model, truth_nodes=LINEAR_NODES, limit_s=None)
    return Grid(setups=(RUBBER, LINEAR, PAPER, *sizes))


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
    """Specimen of a grid by name; `sensor` has a default λ if its file gives none."""
    kind, _, stretch = name.partition(" λ ")
    own = dome(float(stretch)) if kind == "dome" else sensor
    linear = grid.model == "linear"
    known = SensorModel.of(own if linear else rubber_sensor(own))
    made = (LinearPresses if linear else RubberPresses).of(known, grid.truth_nodes)
    return Specimen(name, made, partial(with_noise, known))


def accuracy_study(
    sensor: Sensor,
    grid: Grid,
    parts: Path | None = None,
    specimen_of: Callable[[str, Sensor, Grid], Specimen] = specimen,
) -> Study:
    """Study of a grid, on specimens made by `specimen_of`."""
    settings = {"grid": asdict(grid), "sensor": sensor.model_dump(mode="json")}
    benches = [Bench(specimen_of(name, sensor, grid), grid, parts) for name in grid.specimens]
    cases = [case for bench in benches for case in bench.cases()]
    return Study("accuracy", Row, cases, partial(report_of, grid), settings=settings, parts=parts)


class Bench:
    """Ground truth and pipelines of one membrane."""

    def __init__(self, own: Specimen, grid: Grid, parts: Path | None) -> None:
        folder = None
        if parts is not None:
            folder = create_folder(parts / f"{own.name.replace(' ', '_')}_truth")
        self._own, self._grid = own, grid
        self.bank = TruthBank(own.presses, grid.seed, folder, grid.limit_s)
        self.height_m = float(self.bank.mesh.nodes[:, 2].max())
        self._simulated: dict[Press, SimulatedPress] = {}

    def cases(self) -> list[Case]:
        """Every press, then every setup at every noise."""
        grid, own = self._grid, self._own.name == "sensor"
        runs: dict[str, Callable[[], list[Row]]] = {}
        for obj, share in product(grid.objects if own else grid.others_objects, grid.depths):
            runs[f"{obj} at {100 * share:g} %"] = partial(self._press, obj, share)
        for noise, setup in product(grid.noises, grid.setups):
            if own or setup.nodes is None:
                run = partial(self._rows, setup, noise)
                runs[f"{setup.label}, {noise_name(noise)}"] = run
        return [Case(f"{self._own.name}, {name}", run) for name, run in runs.items()]

    def _press(self, obj: str, share: float) -> list[Row]:
        """Simulate a press for the later cases; makes no rows."""
        (press,) = presses((obj,), (share * self.height_m,))
        self._simulated[press] = self.bank.simulate(press)
        return []

    def _rows(self, setup: Setup, noise: DepthNoise) -> list[Row]:
        pipeline = setup.pipeline(self._own.model(noise))
        rest = self.bank.frames_at_rest(noise, self._grid.repeats + 1)
        zeros = zeros_of(rest, pipeline)
        return [self._row(press, noise, setup, pipeline, zeros) for press in self._simulated]

    def _row(
        self,
        press: Press,
        noise: DepthNoise,
        setup: Setup,
        pipeline: Pipeline,
        zeros: Zeros,
    ) -> Row:
        simulated = self._simulated[press]
        frames = (
            zeros.applied(self.bank.frame(simulated.range_m, noise, k))
            for k in range(self._grid.repeats + 1)
        )
        pipeline.restart()
        cold, *warm = (pipeline.process(frame, PRODUCTS) for frame in frames)
        solved = [r for r in warm if r.estimate is not None and r.estimate.status == "ok"]
        errors = [errors_of(pipeline, result, simulated) for result in solved]
        means: dict[str, Any] = {f.name: over(errors, f.name, np.mean) for f in fields(Errors)}
        statuses = [r.estimate.status for r in warm if r.estimate is not None]
        residuals = [r.estimate.kkt_residual for r in solved if r.estimate is not None]
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
            force_n=float(np.linalg.norm(simulated.truth.force_n)),
            nodes=len(pipeline.mesh.nodes),
            status=next((s for s in statuses if s != "ok"), "ok"),
            failed=len(warm) - len(solved),
            kkt_residual=max(residuals, default=np.nan),
            cold_ms=cold.times_ms["total"],
            warm_ms=float(np.median([result.times_ms["total"] for result in warm])),
        )


def errors_of(pipeline: Pipeline, result: Result, simulated: SimulatedPress) -> Errors:
    """Errors of a pipeline's result with an estimate, a patch and its pixels.

    The ground truth is on another mesh of the same surface.
    """
    estimate, patch, truth = result.estimate, result.patch, simulated.truth
    if estimate is None or patch is None or patch.pixel_mask is None:
        raise ValueError("the result lacks the estimate, the patch or its pixels")
    expected = at_nodes(pipeline.mesh, simulated.mesh, truth.displacement_m)
    force = float(np.linalg.norm(truth.force_n))
    offset = patch.center_of_pressure_m - truth.center_of_pressure_m
    return Errors(
        iou=iou(patch.pixel_mask, truth.patch_mask),
        force_error_relative=truth.force_error(patch.force_n),
        force_excess_relative=float(np.linalg.norm(patch.force_n)) / force - 1.0,
        area_error_relative=patch.area_m2 / truth.patch_area_m2 - 1.0,
        cop_error_m=float(np.linalg.norm(offset)),
        displacement_rms_m=float(np.sqrt(np.mean((estimate.displacement_m - expected) ** 2))),
        gas_error_pa=abs(estimate.gas_pressure_change_pa - truth.gas_pressure_change_pa),
    )


def at_nodes(mesh: MembraneMesh, other: MembraneMesh, field: np.ndarray) -> np.ndarray:
    """Field (m, …) on another mesh of the same surface, interpolated at the nodes, (n, …)."""
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
"""Medians, except mean IoU, worst force error and number of presses with failed frames."""


def curves(rows: list[Row]) -> list[Record]:
    """Errors over depth by setup and material, for the default mesh and image."""
    some = [r for r in rows if r.setup in {s.label for s in (RUBBER, LINEAR, PAPER)}]
    some.sort(key=lambda row: row.depth_share)
    found = summaries(some, ("material", "setup", "depth_share"), AVERAGES)
    return sorted(
        found, key=lambda c: (c["material"] == "identified", c["setup"] != RUBBER.label, c["setup"])
    )


def points(rows: list[Row]) -> list[Record]:
    """Errors and run time of every setup, for one membrane at one noise."""
    deep = [row for row in rows if not row.held_out and row.depth_share >= MIN_DEPTH_SHARE]
    return summaries(deep, ("specimen", "noise", "setup", "nodes"), AVERAGES)


def targets(rows: list[Row], label: str) -> list[Target]:
    """Targets of a setup, and whether each is met."""
    found = list[Target]()
    own = [row for row in rows if row.setup == label]
    for (material, noise), some in groups(own, "material", "noise").items():
        median, worst = FORCE_TARGETS[material]
        name, solved = f"{material}, {noise}", [r for r in some if np.isfinite(r.iou)]
        deep = [row for row in solved if row.depth_share >= MIN_DEPTH_SHARE]
        if solved:
            found += [
                at_most(f"{name}: median force error", over(solved, ERROR), median),
                at_most(f"{name}: worst force error", over(solved, ERROR, np.max), worst),
            ]
        found.append(at_most(f"{name}: presses without estimate", len(some) - len(solved), 0))
        if deep:
            found.append(at_least(f"{name}: mean patch IoU", over(deep, "iou", np.mean), MIN_IOU))
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
)


def report_of(grid: Grid, rows: list[Row]) -> Report:
    """Tables by depth, by setup and by object."""
    label = grid.setups[0].label
    own = [row for row in rows if row.setup == label]
    by = "specimen", "object_name", "noise"
    press = (*(Column(name, name) for name in by), *_ERRORS)
    title = f"Force error over press depth, all membranes and noises; truth: {grid.model} membrane"
    time = f"Errors and run time, presses from {100 * MIN_DEPTH_SHARE:g} % of the height"
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
