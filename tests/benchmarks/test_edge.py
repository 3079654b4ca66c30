"""The study of the patch's edge: oracle, zero error of truth, groups, targets, a small run."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.edge import (
    THRESHOLDS_M,
    EdgeRow,
    best_thresholds,
    edge_in_band,
    edge_study,
    edges,
    iou_by_threshold,
    quick_grid,
    report_of,
    targets,
)
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, LinearPresses, Press, TruthBank, iou, with_nodes

SENSOR = load_sensor("pico_flexx_75mm")  # of constant tension
ONE = DepthNoise(relative=0.01)


@pytest.fixture(scope="module")
def bank():
    return TruthBank(LinearPresses.of(SensorModel.of(SENSOR), 1_500), 7)


def test_ground_truth_lies_within_its_band(bank):
    truth = bank.simulate(Press("sphere", 0.012, False)).truth
    pipeline = Pipeline.of(with_nodes(SENSOR, 1_500))
    estimate = Estimate(
        "ok", truth.displacement_m, truth.contact_pressure_pa, truth.gas_pressure_change_pa, 0, 0
    )
    patch = pipeline.patch(estimate)
    assert edge_in_band(pipeline, estimate, patch, truth.patch_mask) > 0.75


def test_oracle_is_the_best_threshold_with_iou_at_most_1(bank):
    sighting = bank.simulate(Press("sphere", 0.012, False))
    scores = iou_by_threshold(bank, sighting, ONE, 0.0, 0)
    frame = bank.frame(sighting.range_m, ONE, 0)
    change = np.abs(np.nan_to_num(bank.camera.range_image(frame.depth_m) - bank.rest_range_m))
    for k in (0, 60, 100):
        expected = iou(change > THRESHOLDS_M[k], sighting.truth.patch_mask)
        assert scores[k] == pytest.approx(expected)
    (best,) = best_thresholds(bank, [sighting], ONE)
    assert scores.max() <= best <= 1.0


@pytest.mark.long
def test_unknown_parameters_widen_the_edge_band():
    grid = replace(quick_grid(), objects=("sphere",), truth_nodes=700, limit_s=None)
    found = edge_study(with_nodes(SENSOR, 700), grid).run()
    assert found.omitted == [] and len(found.rows) == 2
    for row in found.rows:
        assert 0.5 < row.iou_bound_shape < row.iou_bound_place < 1.0
        assert 0.0 < row.edge_sigma_bound_m < 2e-3


def row(overlap, **changed):
    known = EdgeRow(
        objects="others", object_name="sphere", depth_m=0.015, noise="1 %", setup="rubber",
        failed=0, iou_threshold=0.5, edge_sigma_bound_m=1e-3, iou_bound_place=0.9,
        iou_bound_shape=0.8, iou=overlap, area_error_relative=0.0, edge_in_band=1.0,
    )  # fmt: skip
    return replace(known, **changed)


def test_edges_of_known_rows():
    rows = [
        row(0.8),
        row(0.6, objects="study's own", object_name="ring", area_error_relative=0.1),
        row(np.nan, objects="study's own", object_name="ell", failed=1, edge_in_band=np.nan,
            area_error_relative=np.nan),
    ]  # fmt: skip
    others, own, *each = edges(rows)
    assert (own["count"], own["failed"], own["iou"], own["iou_worst"]) == (2, 1, 0.6, 0.6)
    assert (others["objects"], others["iou"]) == ("others", 0.8)
    assert [edge["objects"] for edge in each] == ["sphere", "ring", "ell"]
    met = {target.name: target.met for target in targets(rows)}
    assert met["study's own, 1 %: mean IoU"] is False
    assert met["others, 1 %: mean IoU"] is True
    assert met["study's own, 1 %: |mean area error|"] is False
    assert "study's own" in report_of(rows).to_text()
