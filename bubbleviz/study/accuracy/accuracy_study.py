"""Error against run time over a grid of presses, noise levels and settings of the estimator."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from bubbleviz.errors import InputError, SolveError
from bubbleviz.files.tables import out_folder, to_json, write_json
from bubbleviz.inverse.estimator import EstimatorOptions
from bubbleviz.inverse.rubber_estimator import RubberEstimator
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.synthetic_source import Model
from bubbleviz.study.accuracy.edge_bound import PLACE, SHAPE, edge_bound
from bubbleviz.study.accuracy.specimens import SPECIMENS, Specimen, Told, specimen
from bubbleviz.study.accuracy.threshold_baseline import Baseline, oracle_baseline
from bubbleviz.study.error_metrics import Errors, Judge
from bubbleviz.study.pose.rubber_truth import TRUTH_NODES as RUBBER_NODES
from bubbleviz.study.presses import (
    EDGE_OBJECTS,
    GRID_OBJECTS,
    HELD_OUT_OBJECTS,
    SMOOTH_OBJECTS,
    Press,
    presses,
)
from bubbleviz.study.truth_bank import TRUTH_NODES, Sighting, TruthBank, noise_name

PRODUCTS: frozenset[Product] = frozenset({"estimate", "patch", "pixel_mask"})
SHALLOWEST_SHARE = 0.2
"""Of the dome's height: patches of shallower presses are as small as the mesh, and not judged."""


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
        return self.pipeline_of(SensorModel.of(sensor))

    def pipeline_of(self, model: SensorModel) -> Pipeline:
        """Pipeline of a sensor whose mesh stays, where no other is asked for."""
        options = replace(EstimatorOptions.named(self.solver), tolerance=self.tolerance)
        if self.relinearisations is not None:
            options = replace(options, relinearisations=self.relinearisations)
        if self.nodes is not None or self.stride > 1:
            varied = strided(with_nodes(model.sensor, self.nodes), self.stride)
            return Pipeline.of(varied, options=options)
        return Pipeline(model, options)


RUBBER, LINEAR = Setup("rubber"), Setup("linear")
BASE_MESH = Setup("rubber-base")
"""The exact membrane without the finer mesh at the contact."""
PAPER = Setup("osqp-cold", relinearisations=0)
"""Eq. 23 by OSQP from rest in every frame, linearised once at the reference surface."""


@dataclass(frozen=True)
class Grid:
    """What an accuracy study runs over.

    Attributes
    ----------
    specimens : tuple of str
        Membranes, see `SPECIMENS`.
    objects, others_objects : tuple of str
        Pressed into `sensor`, and into every other membrane.
    depths : tuple of float
        Shares of the dome's height.
    noises : tuple of DepthNoise
    setups : tuple of Setup
        The first is what the others are compared with. On membranes other than `sensor` those of
        another mesh or image are left out.
    repeats : int
        Warm frames of each press, the same but for their noise.
    model : {"rubber", "linear"}
        Of the truth.
    truth_nodes : int
    limit_s : float or None
        Wall time of one truth.
    seed : int
    """

    specimens: tuple[str, ...] = SPECIMENS
    objects: tuple[str, ...] = GRID_OBJECTS + HELD_OUT_OBJECTS
    others_objects: tuple[str, ...] = SMOOTH_OBJECTS
    depths: tuple[float, ...] = (0.1, 0.2, 0.3, 0.45)
    noises: tuple[DepthNoise, ...] = (DepthNoise(absolute_m=1e-4), DepthNoise(relative=0.01))
    setups: tuple[Setup, ...] = (RUBBER, LINEAR, PAPER)
    repeats: int = 3
    model: Model = "rubber"
    truth_nodes: int = RUBBER_NODES
    limit_s: float | None = 120.0
    seed: int = 7

    def presses(self, specimen: str, height_m: float) -> list[Press]:
        """Every object at every depth."""
        names = self.objects if specimen == "sensor" else self.others_objects
        return presses(names, tuple(share * height_m for share in self.depths))

    def setups_on(self, specimen: str) -> list[Setup]:
        """Setups that run on a membrane."""
        own = specimen == "sensor"
        return [s for s in self.setups if own or (s.nodes is None and s.stride == 1)]


@dataclass(frozen=True)
class Row:
    """One press at one noise level with one setup: means over the warm frames that have an answer.

    `failed` counts those that have none, and `status` says why; `warm_ms` is the median time from
    depth image in to patch pixels out; `cold_ms` that of the first frame of the press;
    `patch_width_m` the mean width of the true patch and `resolution_m` that of the estimate's
    response; `edge_sigma_bound_m` and `iou_bound_shape` are the bounds of `edge_bound` where place
    and shape of the patch are unknown, `iou_bound_place` that where its shape is known.
    """

    specimen: str
    identified: bool
    object_name: str
    held_out: bool
    depth_m: float
    depth_share: float
    noise: str
    setup: str
    solver: str
    nodes: int
    pixel_stride: int
    relinearisations: int
    patch_width_m: float
    resolution_m: float
    force_n: float
    status: str
    failed: int = 0
    iou: float = np.nan
    iou_best_threshold: float = np.nan
    iou_on_mesh: float = np.nan
    force_error_relative: float = np.nan
    force_excess_relative: float = np.nan
    area_error_relative: float = np.nan
    edge_in_band: float = np.nan
    cop_error_m: float = np.nan
    displacement_rms_m: float = np.nan
    gas_error_pa: float = np.nan
    kkt_residual: float = np.nan
    cold_ms: float = np.nan
    warm_ms: float = np.nan
    edge_sigma_bound_m: float = np.nan
    iou_bound_place: float = np.nan
    iou_bound_shape: float = np.nan


@dataclass(frozen=True)
class Material:
    """What the estimator was told of a membrane, and what is true."""

    specimen: str
    noise: str
    gauge_pressure_pa: float
    true_gauge_pressure_pa: float
    tension_n_per_m: float
    true_tension_n_per_m: float
    prestretch: float | None
    true_prestretch: float | None


@dataclass(frozen=True)
class Accuracy:
    """Everything an accuracy study found."""

    grid: Grid
    rows: list[Row]
    materials: list[Material]
    baselines: list[Baseline]
    omitted: list[str]
    """Presses and setups that could not be run, and why."""


def full_grid(model: Model = "rubber") -> Grid:
    """All membranes; on the sensor's also other meshes and images."""
    sizes = [replace(s, nodes=n) for s in (RUBBER, LINEAR, PAPER) for n in (400, 800, 1600)]
    strides = [Setup("rubber", stride=k) for k in (2, 4)]
    setups = (RUBBER, LINEAR, PAPER, *sizes, *strides)
    if model == "linear":
        first = (LINEAR, PAPER, *(s for s in sizes if s.solver != "rubber"), *CROSSED)
        return Grid(("sensor",), setups=first, model=model, truth_nodes=TRUTH_NODES, limit_s=None)
    return Grid(setups=setups)


CROSSED = tuple(
    Setup(s, n, 1, r) for s, n, r in product(("linear", "osqp", "clarabel"), (400, 1600), (0, 1, 2))
)
"""Solvers and relinearisations of the linear model, which is exact where the truth is linear."""


def quick_grid(model: Model = "rubber") -> Grid:
    """A subset that runs in about a minute."""
    full = full_grid(model)
    names = ("sensor",) if model == "linear" else ("sensor", "round sheet, identified λ 1.15")
    return replace(
        full,
        specimens=names,
        objects=("sphere", "puck"),
        others_objects=("sphere",),
        depths=(0.2,),
        noises=full.noises[:1],
        setups=(*full.setups[:3], replace(full.setups[0], nodes=400)),
        repeats=2,
    )


def edge_grid(*, quick: bool = False) -> Grid:
    """For the edge of the patch: other objects, and less noise."""
    noises = tuple(DepthNoise(absolute_m=s) for s in (5e-5, 1.5e-4, 5e-4))
    grid = Grid(
        ("sensor",),
        objects=(*SMOOTH_OBJECTS, "torus", "two_spheres", *EDGE_OBJECTS),
        depths=(0.2, 0.4),
        noises=(*noises, DepthNoise(relative=0.01)),
        setups=(RUBBER, BASE_MESH),
        repeats=1,
        limit_s=900.0,
    )
    few = ("sphere", "unequal_balls")
    return replace(grid, objects=few, depths=(0.2,), noises=noises[:1]) if quick else grid


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
        Folder that keeps truths and finished rows, so that a stopped study goes on there.
    tick : callable
        Called with the name of each membrane when it is done.
    """
    if parts is not None:
        check_same(parts, {"grid": asdict(grid), "sensor": sensor.model_dump(mode="json")})
    found = Accuracy(grid, [], [], [], [])
    for name in grid.specimens:
        try:
            own = specimen(name, sensor, grid.model, grid.truth_nodes, grid.seed)
            _Bench(own, grid, parts, found).run()
        except Exception as error:  # a study reports what breaks, and goes on
            found.omitted.append(f"{name}: {type(error).__name__}: {error}")
        tick(name)
    return found


class _Bench:
    """Runs the setups on one membrane and adds what it finds to what was found."""

    def __init__(self, own: Specimen, grid: Grid, parts: Path | None, found: Accuracy) -> None:
        self._specimen, self._grid, self._found = own, grid, found
        self._parts = _folder(parts, own.name)
        self._bank = TruthBank(
            own.presses, grid.seed, _folder(parts, f"{own.membrane} truth"), grid.limit_s
        )
        self._height_m = float(own.presses.mesh.nodes[:, 2].max())

    def run(self) -> None:
        sightings = self._sightings()
        for noise in self._grid.noises:
            told = self._specimen.told(noise)
            self._found.materials.append(self._material(noise, told))
            for setup in self._grid.setups_on(self._specimen.name):
                try:
                    self._found.rows.extend(self._kept(setup, noise, told, sightings))
                except Exception as error:  # one solver that breaks is no reason to stop
                    what = f"{self._specimen.name}, {setup.label}"
                    self._found.omitted.append(f"{what}: {type(error).__name__}: {error}")
        if self._specimen.name == "sensor":
            self._found.baselines.extend(self._baselines(sightings))

    def _sightings(self) -> list[Sighting]:
        found, name = [], self._specimen.name
        for press in self._grid.presses(name, self._height_m):
            try:
                found.append(self._bank.sighting(press))
            except (InputError, SolveError) as error:
                what = f"{name}, {press.object_name} {1e3 * press.depth_m:.1f} mm"
                self._found.omitted.append(f"{what}: {error}")
        return found

    def _material(self, noise: DepthNoise, model: SensorModel) -> Material:
        told, truth = Told.of(model), self._specimen.truth
        return Material(
            self._specimen.name,
            noise_name(noise),
            told.gauge_pressure_pa,
            truth.gauge_pressure_pa,
            told.tension_n_per_m,
            truth.tension_n_per_m,
            told.prestretch,
            truth.prestretch,
        )

    def _baselines(self, sightings: list[Sighting]) -> list[Baseline]:
        """On the presses that the targets are about."""
        deep = [s for s in sightings if self._share(s) >= SHALLOWEST_SHARE]
        return [
            oracle_baseline(self._bank, own, noise, blur, index=0)
            for name in self._grid.objects
            if (own := [s for s in deep if s.press.object_name == name])
            for noise in self._grid.noises
            for blur in (0.0, 1.0, 2.0)
        ]

    def _share(self, sighting: Sighting) -> float:
        return sighting.press.depth_m / self._height_m

    def _kept(
        self, setup: Setup, noise: DepthNoise, told: SensorModel, sightings: list[Sighting]
    ) -> list[Row]:
        """Rows from an earlier run, or made now and kept."""
        path = None
        if self._parts is not None:
            path = self._parts / f"{setup.label}_{noise_name(noise).replace(' ', '_')}.json"
            if path.exists():
                return [_row_of(record) for record in json.loads(path.read_text(encoding="utf-8"))]
        pipeline = setup.pipeline_of(told)
        rows = [self._row(sighting, noise, setup, pipeline) for sighting in sightings]
        if path is not None:
            write_json(path, [asdict(row) for row in rows])
        return rows

    def _row(self, sighting: Sighting, noise: DepthNoise, setup: Setup, pipeline: Pipeline) -> Row:
        frames = (
            self._bank.frame(sighting, noise, k, setup.stride)
            for k in range(self._grid.repeats + 1)
        )
        pipeline.restart()
        cold, *warm = (pipeline.process(frame, PRODUCTS) for frame in frames)
        answered = [r for r in warm if r.estimate is not None and r.estimate.status == "ok"]
        judge, estimator = Judge(pipeline), pipeline.estimator
        errors = [judge.errors(result, sighting, setup.stride) for result in answered]
        means: dict[str, Any] = {
            f.name: float(np.mean([getattr(e, f.name) for e in errors])) if errors else np.nan
            for f in fields(Errors)
        }
        statuses = [r.estimate.status for r in warm if r.estimate is not None]
        residuals = [r.estimate.kkt_residual for r in answered if r.estimate is not None]
        press, bounds = sighting.press, {}
        if isinstance(estimator, RubberEstimator):
            place, shape = (edge_bound(estimator, sighting, d) for d in (PLACE, SHAPE))
            bounds = {
                "edge_sigma_bound_m": shape.sigma_m,
                "iou_bound_place": place.iou,
                "iou_bound_shape": shape.iou,
            }
        return Row(
            **means,
            **bounds,
            specimen=self._specimen.name,
            identified=self._specimen.identified,
            object_name=press.object_name,
            held_out=press.held_out,
            depth_m=press.depth_m,
            depth_share=round(self._share(sighting), 6),
            noise=noise_name(noise),
            setup=setup.label,
            solver=estimator.solver_name,
            nodes=len(pipeline.mesh.nodes),
            pixel_stride=setup.stride,
            relinearisations=estimator.options.relinearisations,
            patch_width_m=patch_width_m(sighting, pipeline.camera.intrinsics.fx * setup.stride),
            resolution_m=estimator.resolution_m,
            force_n=float(np.linalg.norm(sighting.truth.force_n)),
            status=next((s for s in statuses if s != "ok"), "ok"),
            failed=len(warm) - len(answered),
            kkt_residual=max(residuals, default=np.nan),
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


def _folder(parts: Path | None, name: str) -> Path | None:
    return None if parts is None else out_folder(parts / name.replace(" ", "_"))


def check_same(parts: Path, settings: dict[str, Any]) -> None:
    """Refuse a folder whose parts are of other settings.

    Raises
    ------
    InputError
        They are.
    """
    path, own = parts / "settings.json", json.loads(to_json(settings))
    if not path.exists():
        write_json(path, own)
    elif json.loads(path.read_text(encoding="utf-8")) != own:
        raise InputError(f"{path}: is of another study; choose another folder or delete it")


def _row_of(record: dict[str, Any]) -> Row:
    numbers: dict[str, Any] = {k: np.nan if v is None else v for k, v in record.items()}
    return Row(**numbers)
