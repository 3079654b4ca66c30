"""Delay of slip detection over contact size, and its false-alarm rate.

A ball is dragged in steps. At first the whole contact sticks; then its outer ring slips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from benchmarks.shear import DEPTH_NOISE, HEADING, ShearGrid
from bubbleviz.camera import FlowField, MembraneView
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.sensor_model import SensorModel
from bubbleviz.shear import OpticalFlow
from bubbleviz.simulation import PrintedMembrane
from bubbleviz.study.harness import Case, Column, Report, Study, Table, at_most
from tests.oracles.flow_sighting import sighting
from tests.oracles.stuck_press import Motion, ShearTruth, StuckPress, pressed, shear_sensor

_STICKING, _SLIPPING = 8, 6
"""Frames in which everything sticks, the first being the reference, and in which the ring slips."""
_STEP_M, _SLIP_M = 1e-4, 2.5e-4  # of the object in a frame of either kind
_RING = 0.55  # of the contact's radius, from which on it slips
_FLOW_PX = 0.03
EXACT = f"{_FLOW_PX:g} px"  # `SlipTrial.flow` of exact flow with noise
_AT_REST = 8  # images without contact that optical flow learns from


@dataclass(frozen=True)
class SlipTrial:
    """One drag of one contact, measured by one flow.

    `radius_m` is of the circle with the contact's area; `flow` the noise of an exact flow, or
    "rendered" for optical flow in rendered images. While everything sticks, slip is evaluated at
    `points` (median, 0 if too few). Of `judged` frames without slip, `alarms` are false alarms;
    `found_in` is the frame of slip, from 1, of its first detection, NaN if never.
    """

    radius_m: float
    flow: str
    points: int
    judged: int
    alarms: int
    found_in: float


def slip_study(grid: ShearGrid) -> Study:
    """Every depth of a grid, with exact flows plus noise and with flows of rendered images."""
    cases = [
        Case(f"{1e3 * depth:g} mm", partial(_slip, grid, depth)) for depth in grid.slip_depths_m
    ]
    return Study("slip", SlipTrial, cases, report_of)


def _slip(grid: ShearGrid, depth_m: float) -> list[SlipTrial]:
    trials, model = list[SlipTrial](), SensorModel.of(shear_sensor())
    press = pressed(model.sensor, "sphere", depth_m, grid.truth_nodes)
    truths = list(press.along(_motions(press)))
    radius_m = _radius_m(truths[0])
    for seed in range(grid.slip_seeds):
        seen = [
            sighting(model.camera, truth, DEPTH_NOISE, _FLOW_PX, 100 * seed + k)
            for k, truth in enumerate(truths)
        ]
        depths, flows = [each.depth_m for each in seen], [each.flow for each in seen]
        trials.append(_trial(model, radius_m, EXACT, depths, flows))
    printed = PrintedMembrane(MembraneView(model.camera, truths[0].mesh), grid.seed)
    still = np.zeros(len(truths[0].mesh.nodes))
    rest = [printed.image(still, k) for k in range(_AT_REST)]
    images = [printed.image(t.displacement_m, _AT_REST + k) for k, t in enumerate(truths)]
    flow = OpticalFlow.of(rest)
    trials.append(_trial(model, radius_m, "rendered", depths, [*map(flow.measure, images)]))
    return trials


_COLUMNS = (
    Column("contact's radius mm", "radius_m", ".1f", 1e3),
    *(Column(name, name) for name in ("flow", "points", "alarms", "judged")),
    Column("found in frame", "found_in", ".0f"),
)


def report_of(trials: Sequence[SlipTrial]) -> Report:
    """Every drag, false alarms, and detection delay with exact flow."""
    alarms = sum(t.alarms for t in trials) / max(1, sum(t.judged for t in trials))
    found_in = [t.found_in for t in trials if t.flow == EXACT]
    targets = [
        at_most("false slip, share of frames", alarms, 0.05),
        at_most("slip found, frame", max(np.nan_to_num(found_in, nan=np.inf), default=np.nan), 2.0),
    ]
    return Report([Table("slips", [asdict(t) for t in trials], _COLUMNS)], targets)


def _motions(press: StuckPress) -> list[Motion]:
    x, touching = press.pressed_m, press.touching
    away = np.linalg.norm((x - x[touching].mean(axis=0))[:, :2], axis=1)
    ring = away > _RING * away[touching].max()
    stuck = [k * _STEP_M for k in range(_STICKING)]
    motions = [Motion(way * HEADING) for way in stuck]
    for k in range(1, _SLIPPING + 1):
        way = stuck[-1] + k * _SLIP_M
        motions.append(Motion(way * HEADING, lost=np.where(ring, k * _SLIP_M / way, 0.0)))
    return motions


def _radius_m(truth: ShearTruth) -> float:
    touching = truth.nodal_force_n.any(axis=1)
    return float(np.sqrt(truth.mesh.areas[touching].sum() / np.pi))


def _trial(
    model: SensorModel,
    radius_m: float,
    flow: str,
    depths: list[np.ndarray],
    flows: list[FlowField],
) -> SlipTrial:
    pipeline = Pipeline(model)
    pipeline.use_optical_flow(lambda frame: flows[frame.index])
    points, shares = [], []
    for k, depth_m in enumerate(depths):
        slip = pipeline.process(Frame(k, k / 30.0, depth_m), frozenset({"slip"})).slip
        points.append(0 if slip is None else len(slip.points_m))
        shares.append(np.nan if slip is None else slip.share)
    sticking, slipping = np.array(shares[1:_STICKING]), np.array(shares[_STICKING:])
    found = np.flatnonzero(slipping > 0.0)
    return SlipTrial(
        radius_m,
        flow,
        int(np.median(points[1:_STICKING])),
        int(np.count_nonzero(np.isfinite(sticking))),
        int(np.count_nonzero(sticking > 0.0)),
        float(found[0] + 1) if len(found) else np.nan,
    )
