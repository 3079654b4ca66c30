"""Error of the patch edge over noise, on shipped objects and on objects made for this benchmark.

Compared with the optimal threshold on depth change for each object (by an oracle), and with the
Cramér–Rao bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.edge_bound import PLACE, SHAPE, edge_bound
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate, Patch
from bubbleviz.sensor import Sensor
from bubbleviz.simulation import (
    SMOOTH_OBJECTS,
    TRUTH_NODES,
    DepthNoise,
    Press,
    SimulatedPress,
    TruthBank,
    noise_name,
    presses,
)
from bubbleviz.study import accuracy
from bubbleviz.study.accuracy import Errors, errors_of
from bubbleviz.study.harness import (
    Averages,
    Case,
    Column,
    Record,
    Report,
    Study,
    Table,
    Target,
    at_least,
    at_most,
    summaries,
)
from bubbleviz.zeros import Zeros, zeros_of

EDGE_OBJECTS = tuple(map(str, sorted(Path(__file__).with_name("objects").glob("*.ply"))))
"""Test objects for the edge; no constant was chosen on them."""
SETUPS = (accuracy.RUBBER, accuracy.Setup("rubber-base"))
"""With the finer mesh at the contact, and without."""
THRESHOLDS_M = np.geomspace(1e-4, 4e-2, 120)  # from below noise to above any press
_MIN_IOU = {"0.05 mm": 0.90, "0.15 mm": 0.88, "0.5 mm": 0.83, "1 %": 0.78}
_LARGEST_AREA_ERROR, _MIN_IN_BAND = 0.04, 0.9


@dataclass(frozen=True)
class EdgeGrid:
    """Cases of the edge study."""

    objects: tuple[str, ...] = (*SMOOTH_OBJECTS, "torus", "two_spheres", *EDGE_OBJECTS)
    depths: tuple[float, ...] = (0.2, 0.4)  # shares of the dome's height
    noises: tuple[DepthNoise, ...] = (
        *(DepthNoise(absolute_m=s) for s in (5e-5, 1.5e-4, 5e-4)),
        DepthNoise(relative=0.01),
    )
    truth_nodes: int = TRUTH_NODES
    limit_s: float | None = 900.0
    seed: int = 7


def quick_grid() -> EdgeGrid:
    """Two presses at one noise."""
    return EdgeGrid(("sphere", EDGE_OBJECTS[0]), (0.2,), EdgeGrid().noises[:1])


@dataclass(frozen=True, kw_only=True)
class EdgeRow(Errors):
    """One press at one noise with one setup; errors of its second frame, NaN without an estimate.

    `edge_in_band` is the share of the true edge inside the uncertainty band of the estimated one.
    `edge_sigma_bound_m` and `iou_bound_shape` are the bounds of `edge_bound` if position and shape
    of the patch are unknown, `iou_bound_place` that if its shape is known.
    """

    objects: str  # `study's own`, which no constant was chosen on, or `others`
    object_name: str
    depth_m: float
    noise: str
    setup: str
    failed: int
    iou_threshold: float
    edge_sigma_bound_m: float
    iou_bound_place: float
    iou_bound_shape: float
    edge_in_band: float = np.nan


def edge_study(sensor: Sensor, grid: EdgeGrid) -> Study:
    """Every object at every depth, noise and setup."""
    own = accuracy.Grid(("sensor",), truth_nodes=grid.truth_nodes, seed=grid.seed)
    membrane = accuracy.specimen("sensor", sensor, own)
    bank = TruthBank(membrane.presses, grid.seed, limit_s=grid.limit_s)
    cases = [
        Case(Path(name).stem, partial(_rows, grid, membrane, bank, name)) for name in grid.objects
    ]
    return Study("edge", EdgeRow, cases, report_of)


def _rows(grid: EdgeGrid, membrane: accuracy.Specimen, bank: TruthBank, name: str) -> list[EdgeRow]:
    height, rows = float(bank.mesh.nodes[:, 2].max()), list[EdgeRow]()
    pressed = presses((name,), tuple(share * height for share in grid.depths))
    own = [bank.simulate(press) for press in pressed]
    for noise in grid.noises:
        best = best_thresholds(bank, own, noise)
        for setup in SETUPS:
            pipeline = setup.pipeline(membrane.model(noise))
            zeros = zeros_of(bank.frames_at_rest(noise, 2), pipeline)
            for press, sighting, iou_threshold in zip(pressed, own, best, strict=True):
                row = _row(pipeline, zeros, bank, press, sighting, noise, float(iou_threshold))
                rows.append(replace(row, setup=setup.label))
    return rows


def _row(
    pipeline: Pipeline,
    zeros: Zeros,
    bank: TruthBank,
    press: Press,
    sighting: SimulatedPress,
    noise: DepthNoise,
    threshold: float,
) -> EdgeRow:
    pipeline.restart()
    for k in range(2):
        result = pipeline.process(
            zeros.applied(bank.frame(sighting.range_m, noise, k)), accuracy.PRODUCTS
        )
    estimator = pipeline.estimator
    place, shape = (edge_bound(estimator, sighting, degree) for degree in (PLACE, SHAPE))
    row = EdgeRow(
        objects="study's own" if press.object_name in EDGE_OBJECTS else "others",
        object_name=Path(press.object_name).stem,
        depth_m=press.depth_m,
        noise=noise_name(noise),
        setup="",
        failed=1,
        iou_threshold=threshold,
        edge_sigma_bound_m=shape.sigma_m,
        iou_bound_place=place.iou,
        iou_bound_shape=shape.iou,
    )
    estimate, patch, seen = result.estimate, result.patch, sighting.truth.patch_mask
    if estimate is None or patch is None or estimate.status != "ok":
        return row
    return replace(
        row,
        **vars(errors_of(pipeline, result, sighting)),
        failed=0,
        edge_in_band=edge_in_band(pipeline, estimate, patch, seen),
    )


def edge_in_band(pipeline: Pipeline, estimate: Estimate, patch: Patch, seen: np.ndarray) -> float:
    """Share of the edge pixels of a mask inside the uncertainty band of the patch's edge."""
    edge = ndimage.binary_dilation(seen) ^ ndimage.binary_erosion(seen)
    band, view = patch.edge_half_width_m, pipeline.model.view
    if np.isnan(band) or not edge.any():
        return np.nan
    inner, outer = (view.patch_pixels(estimate, patch, level) for level in (band, -band))
    return float(np.count_nonzero(edge & outer & ~inner) / np.count_nonzero(edge))


def best_thresholds(bank: TruthBank, own: list[SimulatedPress], noise: DepthNoise) -> np.ndarray:
    """IoU (k,) of presses, with the threshold and blur (0 to 2 pixels) that maximise their mean."""
    scores = np.concatenate(
        [[iou_by_threshold(bank, s, noise, blur, 0) for s in own] for blur in (0.0, 1.0, 2.0)],
        axis=1,
    )
    best: np.ndarray = scores[:, np.argmax(scores.mean(axis=0))]
    return best


def iou_by_threshold(
    bank: TruthBank, sighting: SimulatedPress, noise: DepthNoise, blur_px: float, index: int
) -> np.ndarray:
    """IoU of the pixels whose range changed by more than each of the thresholds (t,)."""
    frame, patch = bank.frame(sighting.range_m, noise, index), sighting.truth.patch_mask
    change = np.nan_to_num(bank.camera.range_image(frame.depth_m) - bank.rest_range_m)
    if blur_px > 0.0:
        change = ndimage.gaussian_filter(change, blur_px)
    hit, wrong = (
        np.count_nonzero(mask)
        - np.searchsorted(np.sort(np.abs(change[mask])), THRESHOLDS_M, side="right")
        for mask in (patch, ~patch)
    )
    found: np.ndarray = hit / (np.count_nonzero(patch) + wrong)
    return found


_OTHERS = (
    *("iou_threshold", "edge_sigma_bound_m", "iou_bound_place", "iou_bound_shape"),
    "edge_in_band",
)
_MEANS: Averages = {name: (name, np.mean) for name in (*(f.name for f in fields(Errors)), *_OTHERS)}
_MEANS |= {"iou_worst": ("iou", np.min), "failed": ("failed", np.sum)}


def edges(rows: Sequence[EdgeRow]) -> list[Record]:
    """Mean errors of both groups of objects, then of each object, by noise and setup."""
    both = summaries(rows, ("objects", "noise", "setup"), _MEANS)
    each = summaries(rows, ("object_name", "noise", "setup"), _MEANS)
    return [*both, *({"objects": one["object_name"], **one} for one in each)]


def targets(rows: Sequence[EdgeRow]) -> list[Target]:
    """Whether each group of objects meets the targets of the patch."""
    found = []
    for one in summaries(rows, ("objects", "noise", "setup"), _MEANS):
        if one["setup"] == SETUPS[0].label and one["noise"] in _MIN_IOU:
            name, area = f"{one['objects']}, {one['noise']}", abs(one["area_error_relative"])
            found += [
                at_least(f"{name}: mean IoU", one["iou"], _MIN_IOU[one["noise"]]),
                at_most(f"{name}: |mean area error|", area, _LARGEST_AREA_ERROR),
                at_least(f"{name}: true edge in the band", one["edge_in_band"], _MIN_IN_BAND),
            ]
    return found


_COLUMNS = (
    *(Column(name, name) for name in ("objects", "noise", "setup")),
    Column("presses", "count"),
    Column("failed", "failed", ".0f"),
    Column("IoU", "iou", ".3f"),
    Column("worst", "iou_worst", ".2f"),
    Column("area err %", "area_error_relative", "+.0f", 100),
    Column("edge in band %", "edge_in_band", ".0f", 100),
    Column("depth threshold", "iou_threshold", ".3f"),
    Column("bound: place", "iou_bound_place", ".3f"),
    Column("and shape", "iou_bound_shape", ".3f"),
    Column("edge σ ≥ mm", "edge_sigma_bound_m", ".2f", 1e3),
)


def report_of(rows: Sequence[EdgeRow]) -> Report:
    """Means over groups and objects."""
    title = "Edge of the patch on the sensor, of rubber"
    return Report([Table("edges", edges(rows), _COLUMNS, title)], targets(rows))
