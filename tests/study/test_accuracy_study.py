"""The accuracy study: presses, errors, targets and the report."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate, Result
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, LinearPresses, Press, TruthBank, iou, with_nodes
from bubbleviz.study.accuracy import (
    LINEAR,
    RUBBER,
    Grid,
    Row,
    Setup,
    accuracy_study,
    curves,
    errors_of,
    report_of,
    targets,
)
from bubbleviz.study.harness import write
from tests.program import rows_of
from tests.small_press import changed

NONE, ONE = DepthNoise(), DepthNoise(relative=0.01)
SETUPS = (LINEAR, Setup("paper", nodes=300))
DEPTH_M = 0.012
GRID = Grid(
    specimens=("sensor",),
    objects=("sphere", "hex_nut"),
    depths=(DEPTH_M / 0.05,),
    noises=(NONE, ONE),
    setups=SETUPS,
    repeats=2,
    model="linear",
    truth_nodes=1_500,
    limit_s=None,
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return tmp_path_factory.mktemp("accuracy")


@pytest.fixture(scope="module")
def study(sensor, written):
    return accuracy_study(with_nodes(sensor, 400), GRID).run(written)


def test_the_truth_itself_has_no_errors(sensor):
    bank = TruthBank(LinearPresses.of(SensorModel.of(sensor), 1_500), 7)
    sighting = bank.simulate(Press("sphere", 0.012, False))
    pipeline = Pipeline.of(changed(sensor, membrane={"nodes": 1_500}))
    assert np.array_equal(pipeline.mesh.nodes, bank.mesh.nodes)
    truth = sighting.truth
    estimate = Estimate(
        "ok", truth.displacement_m, truth.contact_pressure_pa, truth.gas_pressure_change_pa, 0, 0
    )
    patch = replace(pipeline.patch(estimate), pixel_mask=truth.patch_mask)
    errors = errors_of(
        pipeline, Result(bank.frame(sighting.range_m, NONE, 0), estimate, patch), sighting
    )
    assert errors.iou == 1.0
    assert errors.force_error_relative == pytest.approx(0.0, abs=1e-12)
    assert errors.cop_error_m < 1e-3  # the reported centre is that of the patch alone
    assert errors.displacement_rms_m < 1e-7  # the closest point is found in single precision


def test_iou_of_masks():
    a, b = np.array([1, 1, 0, 0], bool), np.array([1, 0, 1, 0], bool)
    assert iou(a, b) == pytest.approx(1 / 3)
    assert iou(a & False, b & False) == 1.0


def test_structure(study):
    assert len(study.rows) == 2 * 2 * len(SETUPS)
    assert study.omitted == []
    for row in study.rows:
        assert row.status == "ok"
        assert 0.0 < row.iou <= 1.0
        assert row.force_error_relative < (0.1 if row.setup == "linear" else 0.25)
        assert abs(row.force_excess_relative) <= row.force_error_relative + 1e-12
        assert row.displacement_rms_m < 1e-3
        assert row.cop_error_m < 2e-3
        assert row.warm_ms > 0.0
    assert {row.held_out for row in study.rows if row.object_name == "hex_nut"} == {True}


def test_a_failing_solver_is_left_out_and_named(sensor, tmp_path):
    grid = replace(GRID, objects=("sphere",), noises=(NONE,), setups=(Setup("magic"),))
    found = accuracy_study(sensor, grid).run(tmp_path)
    assert json.loads((tmp_path / "accuracy.json").read_text())["rows"] == []
    assert found.rows == []
    assert "magic" in found.omitted[0]
    assert "omitted: sensor, magic" in found.to_text()


def test_a_stopped_study_goes_on(sensor, tmp_path):
    grid = replace(GRID, objects=("sphere",), noises=(ONE,), setups=SETUPS[1:])
    first = accuracy_study(sensor, grid, tmp_path).run()
    again = accuracy_study(sensor, grid, tmp_path).run()
    np.testing.assert_equal([*map(asdict, again.rows)], [*map(asdict, first.rows)])  # NaN as NaN
    with pytest.raises(InputError, match="a study with other settings"):
        accuracy_study(sensor, replace(grid, seed=8), tmp_path).run()


def test_a_simulation_that_takes_too_long_is_left_out_and_named(sensor):
    grid = replace(GRID, objects=("sphere",), noises=(NONE,), limit_s=0.0)
    found = accuracy_study(sensor, grid).run()
    assert found.rows == []
    assert "sphere at 24 %: SolveError: no answer within 0 s" in found.omitted[0]


@pytest.mark.long  # in short: in test_linear_on_rubber.py and test_rubber_estimator.py
def test_on_rubber_the_exact_estimator_is_right_and_the_linear_one_is_not(sensor):
    grid = Grid(
        specimens=("dome λ 1.2",),
        others_objects=("sphere",),
        depths=(0.25,),
        noises=(DepthNoise(absolute_m=1e-4),),
        setups=(RUBBER, LINEAR),
        repeats=1,
        truth_nodes=700,
        limit_s=None,
    )
    found = accuracy_study(sensor, grid).run()
    assert found.omitted == []
    exact, linear = found.rows
    assert exact.force_error_relative < 0.02
    assert linear.force_excess_relative > 0.05
    assert exact.force_n == linear.force_n > 1.0
    assert {curve["depth_share"] for curve in curves(found.rows)} == {0.25}


def test_report_files(study, written, sensor):
    lines = rows_of(written / "accuracy.csv")
    assert len(lines) == len(study.rows)
    assert {"depth_m", "warm_ms", "cop_error_m", "gas_error_pa"} <= set(lines[0])
    data = json.loads((written / "accuracy.json").read_text())
    assert {"targets", "curves", "points", "objects", "rows", "grid", "omitted"} == set(data)
    assert (written / "accuracy.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="exists"):
        accuracy_study(sensor, GRID).run(written)


def row(setup, ms, overlap, force, **changed):
    known = Row(
        specimen="sensor", material="known", object_name="sphere", held_out=False, depth_m=0.015,
        depth_share=0.3, noise="1 %", setup=setup, force_n=5.0, nodes=800, iou=overlap,
        force_error_relative=force, warm_ms=ms,
    )  # fmt: skip
    return replace(known, **changed)


def test_targets_on_known_rows():
    assert all(t.met for t in targets([row("a", 5, 0.8, 0.01), row("b", 9, 0.7, 0.2)], "a"))
    worse = [row("a", 5, 0.1, 0.051), row("a", 5, np.nan, np.nan, failed=2)]
    found = targets(worse, "a")
    assert len(found) == 4 and not any(t.met for t in found)
    assert not targets([row("a", 5, 0.8, 0.029)], "a")[0].met
    assert all(t.met for t in targets([row("a", 5, 0.8, 0.029, material="identified")], "a"))


@pytest.mark.parametrize("changed", [{"specimen": "sheet"}, {"depth_share": 0.1}])
def test_rows_without_the_sensor_or_of_shallow_presses_alone_are_drawn(changed, tmp_path):
    rows = [row("rubber", 5, 0.8, 0.01, **changed)]
    write(replace(report_of(GRID, rows), rows=rows), tmp_path, "accuracy")
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000


def test_curves_tell_median_worst_and_what_has_no_answer():
    rows = [row("rubber", 5, 0.8, e) for e in (0.01, 0.02, 0.09)]
    (curve,) = curves([*rows, row("rubber", 5, 0, np.nan, failed=1), row("rubber_n400", 5, 0, 1)])
    assert (curve["count"], curve["failed"]) == (4, 1)
    assert (curve["force_error_relative"], curve["worst"]) == (0.02, 0.09)
    assert "rubber by object" in report_of(replace(GRID, setups=(RUBBER,)), rows).to_text()
