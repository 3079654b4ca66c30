"""Run time of each optical-flow preset, and its errors of flow and force.

The texture is rendered on the true membrane, so that the flow is computed from images.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import NamedTuple, get_args

import numpy as np

from benchmarks.shear import DEPTH_NOISE, ShearGrid, judged
from bubbleviz.camera import MembraneView
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.sensor_model import SensorModel
from bubbleviz.shear import FlowField, FlowPreset, OpticalFlow, opencv
from bubbleviz.simulation import PrintedMembrane, Speckle
from bubbleviz.study.harness import Case, Column, Report, Study, Table
from tests.oracles.flow_sighting import FlowSighting, sighting
from tests.oracles.stuck_press import ShearTruth, pressed, shear_sensor

_AT_REST = 8  # images without contact that each preset learns from


@dataclass(frozen=True)
class PresetScore:
    """One preset over the frames of a drag.

    `solved` is the share of the frames with a traction, `flow_rms_px` the error per component over
    the blocks found, `force_error` the largest |F − F_true| / |F_true|, `flow_ms` the processor
    time of the flow of a frame (median).
    """

    preset: str
    solved: float
    flow_rms_px: float
    force_error: float
    flow_ms: float


def flow_study(grid: ShearGrid) -> Study:
    """Every preset on the drag of the first object of a grid; InputError without OpenCV."""
    opencv()  # fail early
    case = Case("drag", partial(run_flow_presets, grid))
    return Study("flow_presets", PresetScore, [case], report_of)


def run_flow_presets(grid: ShearGrid) -> list[PresetScore]:
    """Render the drag once, and compute its flow with every preset."""
    model = SensorModel.of(shear_sensor())
    press = pressed(model.sensor, *grid.objects[0], grid.truth_nodes)
    truths = list(press.along(grid.paths[0]))
    mesh = truths[0].mesh
    printed = PrintedMembrane(Speckle(seed=grid.seed), MembraneView(model.camera, mesh))
    rest = [printed.image(np.zeros(len(mesh.nodes)), k) for k in range(_AT_REST)]
    frames = []
    for k, truth in enumerate(truths):
        seen = sighting(model.camera, truth, DEPTH_NOISE, 0.0, grid.seed + k)
        frames.append(_Rendered(truth, seen, printed.image(truth.displacement_m, _AT_REST + k)))
    return [_score(OpticalFlow.of(rest, preset), model, frames) for preset in get_args(FlowPreset)]


_COLUMNS = (
    Column("flow", "preset"),
    Column("solved %", "solved", ".0f", 100),
    Column("flow error px", "flow_rms_px", ".3f"),
    Column("force %, worst", "force_error", ".1f", 100),
    Column("flow ms", "flow_ms", ".0f"),
)


def report_of(scores: Sequence[PresetScore]) -> Report:
    """Every preset."""
    return Report([Table("flow_presets", [asdict(score) for score in scores], _COLUMNS)])


class _Rendered(NamedTuple):
    """A frame: truth, depth with noise and exact flow, and the rendered image."""

    truth: ShearTruth
    exact: FlowSighting
    image: np.ndarray


def _score(flow: OpticalFlow, model: SensorModel, frames: list[_Rendered]) -> PresetScore:
    pipeline, fields = Pipeline(model), list[FlowField]()
    pipeline.use_optical_flow(lambda frame: fields[frame.index])
    times_ms, flow_errors, force_errors = [], [], []
    for k, seen in enumerate(frames):
        begun = time.process_time()
        fields.append(flow.measure(seen.image))
        times_ms.append(1e3 * (time.process_time() - begun))
        flow_errors.append(_errors_px(fields[-1], seen.exact.flow))
        frame = Frame(k, k / 30.0, seen.exact.depth_m)
        result = pipeline.process(frame, frozenset({"traction"}))
        trial = judged(result, seen.truth, model.mesh)
        if trial.status == "ok":
            force_errors.append(trial.force_error)
    return PresetScore(
        flow.preset,
        len(force_errors) / len(frames),
        float(np.sqrt(np.mean(np.concatenate(flow_errors) ** 2))),
        max(force_errors, default=np.nan),
        float(np.median(times_ms)),
    )


def _errors_px(field: FlowField, exact: FlowField) -> np.ndarray:
    """Errors (k, 2) of the blocks that both have."""
    _, found, true = np.intersect1d(field.pixel, exact.pixel, return_indices=True)
    away: np.ndarray = field.moved_px[found] - exact.moved_px[true]
    return away
