"""Error against run time over a grid of presses, noise levels and settings of the estimator."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.tables import write_json
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.study.accuracy.threshold_baseline import Baseline, oracle_baseline
from bubbleviz.study.error_metrics import Errors, Judge
from bubbleviz.study.presses import GRID_OBJECTS, HELD_OUT_OBJECTS, Press, presses
from bubbleviz.study.truth_bank import TRUTH_NODES, Sighting, TruthBank

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})
SOLVERS = ("linear", "osqp", "osqp-cold", "clarabel")


@dataclass(frozen=True)
class Setup:
    """Settings of an estimator; None is what the sensor file and the defaults say.

    Attributes
    ----------
    solver : str or None
    nodes : int or None
    stride : int
        Every stride-th pixel of every stride-th row.
    relinearisations : int or None
    tolerance : float or None
    """

    solver: str | None = None
    nodes: int | None = None
    stride: int = 1
    relinearisations: int | None = None
    tolerance: float | None = None

    @property
    def label(self) -> str:
        """Short name, usable as a file name."""
        parts = [
            self.solver or "default",
            f"n{self.nodes}" if self.nodes else "",
            f"stride{self.stride}" if self.stride > 1 else "",
            f"relin{self.relinearisations}" if self.relinearisations is not None else "",
            f"eps{self.tolerance:.0e}" if self.tolerance is not None else "",
        ]
        return "_".join(filter(None, parts))

    def pipeline(self, sensor: Sensor) -> Pipeline:
        """Pipeline with these settings."""
        options = EstimatorOptions(solver=self.solver, tolerance=self.tolerance)
        if self.relinearisations is not None:
            options = replace(options, relinearisations=self.relinearisations)
        varied = strided(with_nodes(sensor, self.nodes), self.stride)
        return Pipeline.of(varied, options=options)


@dataclass(frozen=True)
class Grid:
    """What an accuracy study runs over.

    Attributes
    ----------
    objects : tuple of str
    depths_m : tuple of float
    noises_relative : tuple of float
    setups : tuple of Setup
        The first is the shipped default.
    repeats : int
        Warm frames of each press, the same but for their noise.
    truth_nodes : int
    seed : int
    """

    objects: tuple[str, ...] = GRID_OBJECTS + HELD_OUT_OBJECTS
    depths_m: tuple[float, ...] = (0.005, 0.010, 0.015, 0.020)
    noises_relative: tuple[float, ...] = (0.0, 0.005, 0.01)
    setups: tuple[Setup, ...] = (Setup(),)
    repeats: int = 4
    truth_nodes: int = TRUTH_NODES
    seed: int = 7

    def presses(self) -> list[Press]:
        """Every object at every depth."""
        return presses(self.objects, self.depths_m)


@dataclass(frozen=True)
class Row:
    """One press at one noise level with one setup: means over the warm frames.

    `warm_ms` is the median time from depth image in to patch pixels out; `cold_ms` that of the
    first frame of the press; `patch_width_m` the mean width of the true patch and `resolution_m`
    that of the estimate's response. A setup or press without an answer has a status that says why.
    """

    object_name: str
    held_out: bool
    depth_m: float
    noise_relative: float
    setup: str
    solver: str
    nodes: int
    pixel_stride: int
    relinearisations: int
    patch_width_m: float
    resolution_m: float
    status: str
    iou: float = np.nan
    iou_best_threshold: float = np.nan
    force_error_relative: float = np.nan
    cop_error_m: float = np.nan
    displacement_rms_m: float = np.nan
    gas_error_pa: float = np.nan
    kkt_residual: float = np.nan
    cold_ms: float = np.nan
    warm_ms: float = np.nan


@dataclass(frozen=True)
class Accuracy:
    """Everything an accuracy study found."""

    grid: Grid
    rows: list[Row]
    baselines: list[Baseline]
    omitted: list[str]
    """Presses and setups that could not be run, and why."""


def full_grid() -> Grid:
    """Solvers, mesh sizes and relinearisations crossed; strides with the default."""
    crossed = [Setup(s, n, 1, r) for s, n, r in product(SOLVERS, (400, 800, 1600, 3000), (0, 1, 2))]
    strides = [Setup(stride=k) for k in (2, 3, 4, 6)]
    return Grid(setups=(Setup(), *strides, *crossed))


def quick_grid() -> Grid:
    """A subset that runs in less than a minute."""
    setups = (
        Setup(),
        Setup(relinearisations=0),
        Setup(nodes=400),
        Setup(stride=3),
        Setup(solver="osqp-cold", nodes=400, relinearisations=0),
    )
    return Grid(
        objects=("two_legged_toy", "sphere", "hex_nut"),
        depths_m=(0.015,),
        noises_relative=(0.0, 0.01),
        setups=setups,
        repeats=2,
    )


def with_nodes(sensor: Sensor, nodes: int | None) -> Sensor:
    """Sensor with another target number of nodes."""
    if nodes is None:
        return sensor
    membrane = sensor.membrane.model_copy(update={"nodes": nodes})
    return sensor.model_copy(update={"membrane": membrane})


def strided(sensor: Sensor, stride: int) -> Sensor:
    """Sensor whose camera has only every stride-th pixel of every stride-th row."""
    if stride == 1:
        return sensor
    own = sensor.camera
    camera = own.model_copy(
        update={
            "width": -(-own.width // stride),
            "height": -(-own.height // stride),
            **{name: getattr(own, name) / stride for name in ("fx", "fy", "cx", "cy")},
        }
    )
    return sensor.model_copy(update={"camera": camera})


def run_accuracy(
    sensor: Sensor,
    grid: Grid,
    parts: Path | None = None,
    tick: Callable[[str], None] = lambda _: None,
) -> Accuracy:
    """Run a grid.

    Parameters
    ----------
    sensor : Sensor
    grid : Grid
    parts : Path, optional
        Folder that keeps the rows of every finished setup, so that a stopped study goes on there.
    tick : callable
        Called with a setup's label when it is done.
    """
    bank = TruthBank(sensor, grid.seed, grid.truth_nodes)
    sightings, omitted = _sightings(bank, grid)
    rows: list[Row] = []
    for setup in grid.setups:
        try:
            rows += _kept(parts, grid, setup, partial(_run, bank, sightings, grid, setup))
        except Exception as error:  # a study reports a solver that breaks, and goes on
            omitted.append(f"{setup.label}: {type(error).__name__}: {error}")
        tick(setup.label)
    return Accuracy(grid, rows, _baselines(bank, sightings, grid), omitted)


def _sightings(bank: TruthBank, grid: Grid) -> tuple[list[Sighting], list[str]]:
    found, omitted = [], []
    for press in grid.presses():
        try:
            found.append(bank.sighting(press))
        except (InputError, SolveError) as error:
            omitted.append(f"{press.object_name} {1e3 * press.depth_m:.0f} mm: {error}")
    return found, omitted


def _baselines(bank: TruthBank, sightings: list[Sighting], grid: Grid) -> list[Baseline]:
    """On the presses that the targets are about, 10 mm and deeper."""
    return [
        oracle_baseline(bank, own, noise, blur, index=0)
        for name in grid.objects
        if (own := [s for s in sightings if s.press.object_name == name and is_deep(s.press)])
        for noise in grid.noises_relative
        for blur in (0.0, 1.0, 2.0)
    ]


def is_deep(press: Press | Row) -> bool:
    """Whether the targets apply to a press: 10 mm and deeper."""
    return press.depth_m > 0.0099


def _run(bank: TruthBank, sightings: list[Sighting], grid: Grid, setup: Setup) -> list[Row]:
    pipeline = setup.pipeline(bank.sensor)
    judge = Judge(pipeline, bank.mesh)
    return [
        _row(bank, sighting, noise, setup, pipeline, judge, grid.repeats)
        for noise in grid.noises_relative
        for sighting in sightings
    ]


def _row(
    bank: TruthBank,
    sighting: Sighting,
    noise: float,
    setup: Setup,
    pipeline: Pipeline,
    judge: Judge,
    repeats: int,
) -> Row:
    frames = [bank.frame(sighting, noise, k, setup.stride) for k in range(repeats + 1)]
    pipeline.restart()
    cold, *warm = (pipeline.process(frame, PRODUCTS) for frame in frames)
    errors = [judge.errors(result, sighting.truth, setup.stride) for result in warm]
    means: dict[str, Any] = {
        f.name: float(np.mean([getattr(e, f.name) for e in errors])) for f in fields(Errors)
    }
    estimates = [result.estimate for result in warm if result.estimate is not None]
    bad = [estimate.status for estimate in estimates if estimate.status != "ok"]
    estimator = pipeline.estimator
    return Row(
        **means,
        object_name=sighting.press.object_name,
        held_out=sighting.press.held_out,
        depth_m=sighting.press.depth_m,
        noise_relative=noise,
        setup=setup.label,
        solver=estimator.solver_name,
        nodes=len(pipeline.mesh.nodes),
        pixel_stride=setup.stride,
        relinearisations=estimator.options.relinearisations,
        patch_width_m=patch_width_m(sighting, pipeline.camera.intrinsics.fx * setup.stride),
        resolution_m=estimator.resolution_m,
        status=bad[0] if bad else "ok",
        kkt_residual=max(estimate.kkt_residual for estimate in estimates),
        cold_ms=cold.times_ms["total"],
        warm_ms=_median_ms(warm),
    )


def patch_width_m(sighting: Sighting, focal_px: float) -> float:
    """Mean width of the true patch, m: four times the mean distance to its edge, as of a strip."""
    mask = sighting.truth.patch_mask
    if not mask.any():
        return 0.0
    pixel = float(np.median(sighting.range_m[mask])) / focal_px
    return 4.0 * pixel * float(distance_transform_edt(mask)[mask].mean())


def _median_ms(results: list[Result]) -> float:
    return float(np.median([result.times_ms["total"] for result in results]))


def _kept(parts: Path | None, grid: Grid, setup: Setup, run: Callable[[], list[Row]]) -> list[Row]:
    """Rows from an earlier run of the same grid, or made now and kept."""
    if parts is None:
        return run()
    own = json.loads(json.dumps(asdict(replace(grid, setups=(setup,)))))
    path = parts / f"{setup.label}.json"
    if path.exists():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept["grid"] != own:
            raise InputError(f"{path}: is of another grid; choose another folder or delete it")
        return [_row_of(record) for record in kept["rows"]]
    rows = run()
    write_json(path, {"grid": own, "rows": [asdict(row) for row in rows]})
    return rows


def _row_of(record: dict[str, Any]) -> Row:
    numbers: dict[str, Any] = {k: np.nan if v is None else v for k, v in record.items()}
    return Row(**numbers)
