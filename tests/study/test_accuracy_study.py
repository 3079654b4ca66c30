"""The accuracy study: presses, errors, the oracle baseline, targets and the report."""

import csv
import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.errors import InputError
from bubbleviz.membrane.refine import refine
from bubbleviz.pipeline import Pipeline
from bubbleviz.result import Estimate, Result
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.study.accuracy import accuracy_report, edge_report
from bubbleviz.study.accuracy.accuracy_study import (
    LINEAR,
    PRODUCTS,
    RUBBER,
    Grid,
    Row,
    Setup,
    patch_width_m,
    run_accuracy,
    strided,
)
from bubbleviz.study.accuracy.threshold_baseline import THRESHOLDS_M, iou_by_threshold
from bubbleviz.study.error_metrics import Judge, iou
from bubbleviz.study.inflated_rubber import InflatedRubber
from bubbleviz.study.presses import (
    EDGE_OBJECTS,
    GRID_OBJECTS,
    HELD_OUT_OBJECTS,
    Press,
    made,
    presses,
)
from bubbleviz.study.report_files import check_free
from bubbleviz.study.truth_bank import LinearPresses, TruthBank

NONE, ONE = DepthNoise(), DepthNoise(relative=0.01)
SETUPS = (LINEAR, Setup("linear", nodes=300, relinearisations=0))
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
def sensor():
    return load_sensor("pico_flexx_75mm")


@pytest.fixture(scope="module")
def bank(sensor):
    return TruthBank(LinearPresses(SensorModel.of(sensor), 1_500), 7)


@pytest.fixture(scope="module")
def study(sensor):
    return run_accuracy(sensor, GRID)


@pytest.mark.parametrize("name", GRID_OBJECTS + HELD_OUT_OBJECTS)
def test_presses_are_as_deep_as_they_say_and_repeat(name, bank):
    press = Press(name, 0.004, False)
    pose = press.pose(bank.mesh, 3)
    assert np.array_equal(pose, press.pose(bank.mesh, 3))
    assert not np.allclose(pose, press.pose(bank.mesh, 4))
    obj = made(name)
    assert np.linalg.norm(pose[:2, 3]) <= 0.008
    assert np.arccos(pose[2, 2]) <= 0.15
    # lifted by its depth it touches: no vertex is under the sphere, and one is within 0.4 mm
    vertices = obj.vertices @ pose[:3, :3].T + pose[:3, 3] + [0.0, 0.0, press.depth_m]
    radius = (0.075**2 + 0.05**2) / 0.1
    gap = np.linalg.norm(vertices - [0.0, 0.0, 0.05 - radius], axis=1) - radius
    assert -2e-4 < gap.min() < 4e-4


VOLUMES_MM3 = {
    "cross": (2 * 40 * 10 - 10**2) * 20,
    "ring": np.pi * (16**2 - 9**2) * 30,
    "rounded_cross": (2 * 40 * 12 - 12**2) * 30,
    "unequal_balls": 4 / 3 * np.pi * (7**3 + 11**3),
    "ell": (26 * 12 + 14 * 12) * 30,
    "thin_bar": 36 * 8 * 30,
    "small_nut": (18**2 * np.sqrt(3) / 2 - np.pi * 4**2) * 30,
}
"""Of these rounded edges and corners take some per cent away."""


@pytest.mark.parametrize("name", ["cross", *EDGE_OBJECTS])
def test_objects_of_the_study_are_watertight_with_their_volume(name):
    obj = made(name)
    a, b, c = (obj.vertices[obj.triangles[:, k]] for k in range(3))
    edges = np.sort(obj.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)
    volume = np.einsum("ij,ij->", np.cross(a, b), c) / 6.0
    lost = 1.0 - volume / (1e-9 * VOLUMES_MM3[name])
    assert abs(lost) < 1e-5 if name == "cross" else 0.0 < lost < 0.06


def test_patch_width_of_a_strip(bank):
    sighting = bank.sighting(Press("sphere", 0.012, False))
    mask = np.zeros((171, 224), bool)
    mask[60:68, 20:200] = True
    level = replace(sighting, range_m=np.full(mask.shape, 0.1))
    level = replace(level, truth=replace(sighting.truth, patch_mask=mask))
    # 8 pixels of 0.1 m / 200: 4 mm; pixel centres and the two short ends take a little
    assert patch_width_m(level, 200.0) == pytest.approx(0.004, rel=0.3)
    mask[60:92] = True
    assert patch_width_m(level, 200.0) > 0.008


def test_held_out_objects_are_marked():
    marked = {
        p.object_name for p in presses(GRID_OBJECTS + HELD_OUT_OBJECTS, (0.01,)) if p.held_out
    }
    assert marked == {"cross", "cylinder", "hex_nut"}


def test_the_truth_itself_has_no_errors(sensor, bank):
    sighting = bank.sighting(Press("sphere", 0.012, False))
    pipeline = Pipeline.of(
        sensor.model_copy(update={"membrane": sensor.membrane.model_copy(update={"nodes": 1_500})})
    )
    assert np.array_equal(pipeline.mesh.nodes, bank.mesh.nodes)
    truth = sighting.truth
    estimate = Estimate(
        "ok", truth.displacement_m, truth.contact_pressure_pa, truth.gas_pressure_change_pa, 0, 0
    )
    patch = replace(pipeline.patch(estimate), pixel_mask=truth.patch_mask)
    result = Result(bank.frame(sighting, NONE, 0), estimate, patch)
    errors = Judge(pipeline).errors(result, sighting)
    assert errors.iou == 1.0
    assert errors.force_error_relative == pytest.approx(0.0, abs=1e-12)
    assert errors.cop_error_m < 1e-3  # the reported centre is that of the patch alone
    assert errors.displacement_rms_m < 1e-7  # the closest point is found in single precision
    assert errors.iou_best_threshold > 0.85
    assert errors.edge_in_band > 0.75


def test_iou_of_masks():
    a, b = np.array([1, 1, 0, 0], bool), np.array([1, 0, 1, 0], bool)
    assert iou(a, b) == pytest.approx(1 / 3)
    assert iou(a & False, b & False) == 1.0


def test_strided_camera_sees_the_same_rays(sensor):
    from bubbleviz.camera.depth_camera import DepthCamera

    every = DepthCamera.of(sensor.camera)
    third = DepthCamera.of(strided(sensor, 3).camera)
    size = (sensor.camera.height, sensor.camera.width, 3)
    expected = every.directions.reshape(size)[::3, ::3].reshape(-1, 3)
    assert np.allclose(third.directions, expected)


def test_noise_differs_from_frame_to_frame_and_repeats(bank):
    sighting = bank.sighting(Press("sphere", 0.012, False))
    first, again, second = (bank.frame(sighting, ONE, k).depth_m for k in (0, 0, 1))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, second, equal_nan=True)


def test_structure(study):
    assert len(study.rows) == 2 * 2 * len(SETUPS)
    assert study.omitted == []
    for row in study.rows:
        assert row.status == "ok"
        assert 0.0 < row.iou <= 1.0
        assert 0.0 < row.iou_best_threshold <= 1.0
        assert row.force_error_relative < (0.1 if row.setup == "linear" else 0.25)
        assert abs(row.force_excess_relative) <= row.force_error_relative + 1e-12
        assert row.displacement_rms_m < 1e-3
        assert row.cop_error_m < 2e-3
        assert row.warm_ms > 0.0
    assert {row.held_out for row in study.rows if row.object_name == "hex_nut"} == {True}


def test_the_oracle_is_the_best_threshold_and_no_better_than_1(study, bank):
    assert len(study.baselines) == 2 * 2 * 3
    assert all(0.0 < base.iou <= 1.0 for base in study.baselines)
    sighting = bank.sighting(Press("sphere", 0.012, False))
    scores = iou_by_threshold(bank, sighting, ONE, 0.0, 0)
    frame = bank.frame(sighting, ONE, 0)
    change = np.abs(np.nan_to_num(bank.camera.range_image(frame.depth_m) - bank.rest_range_m))
    for k in (0, 60, 100):
        expected = iou(change > THRESHOLDS_M[k], sighting.truth.patch_mask)
        assert scores[k] == pytest.approx(expected)
    base = next(
        b for b in study.baselines if (b.object_name, b.noise, b.blur_px) == ("sphere", "1 %", 0.0)
    )
    assert base.iou == pytest.approx(scores.max())


def test_a_solver_that_breaks_is_left_out_by_name(sensor):
    grid = replace(GRID, objects=("sphere",), noises=(NONE,), setups=(Setup("magic"),))
    found = run_accuracy(sensor, grid)
    assert found.rows == []
    assert "magic" in found.omitted[0]
    accuracy_report.to_text(found)


def test_a_stopped_study_goes_on(sensor, tmp_path):
    grid = replace(GRID, objects=("sphere",), noises=(ONE,), setups=SETUPS[1:])
    first = run_accuracy(sensor, grid, tmp_path)
    again = run_accuracy(sensor, grid, tmp_path)
    np.testing.assert_equal([*map(asdict, again.rows)], [*map(asdict, first.rows)])  # NaN as NaN
    with pytest.raises(InputError, match="another study"):
        run_accuracy(sensor, replace(grid, seed=8), tmp_path)


def test_a_kept_truth_is_the_truth(sensor, tmp_path, bank):
    press = Press("sphere", DEPTH_M, False)
    model = SensorModel.of(sensor)
    first, kept = (
        TruthBank(LinearPresses(model, 1_500), 7, tmp_path).sighting(press) for _ in range(2)
    )
    fresh = bank.sighting(press)
    for one in (first, kept):
        assert np.array_equal(one.range_m, fresh.range_m, equal_nan=True)
        assert np.array_equal(one.truth.force_n, fresh.truth.force_n)
        assert np.array_equal(one.mesh.triangles, fresh.mesh.triangles)


def test_a_truth_that_takes_too_long_is_left_out_by_name(sensor):
    grid = replace(GRID, objects=("sphere",), noises=(NONE,), limit_s=0.0)
    found = run_accuracy(sensor, grid)
    assert found.rows == []
    assert "sphere 12.0 mm: no answer within 0 s" in found.omitted[0]


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
    found = run_accuracy(sensor, grid)
    assert found.omitted == []
    exact, linear = found.rows
    # more that is not known makes the edge less certain; what the mesh draws is nearly the truth
    assert 0.5 < exact.iou_bound_shape < exact.iou_bound_place < 1.0
    assert 0.0 < exact.edge_sigma_bound_m < 1e-3
    assert exact.iou_on_mesh > 0.9
    assert np.isnan(linear.iou_bound_shape)
    assert exact.force_error_relative < 0.02
    assert linear.force_excess_relative > 0.05
    assert exact.force_n == linear.force_n > 1.0
    told = found.materials[0]
    assert told.prestretch == told.true_prestretch == 1.2
    assert {curve.depth_share for curve in accuracy_report.curves(found)} == {0.25}


def test_another_mesh_of_an_inflated_sheet_is_on_its_surface():
    """And a finer one of the same facets is in equilibrium, as stiff as the sheet."""
    sheet = InflatedRubber.round_sheet(0.045, 110.0, 1.15, 2500.0)
    rest = sheet.rest
    other = sheet.resting(300)
    assert len(other.nodes) < 0.2 * len(rest.nodes)
    away = TriangleScene(rest.nodes, rest.triangles).closest(other.nodes).point - other.nodes
    assert np.linalg.norm(away[~other.rim], axis=1).max() < 1e-6
    fine = sheet.rubber(refine(rest, rest.nodes[rest.triangles].mean(axis=1)[:, 0] > 0.03))
    moved = TriangleScene(rest.nodes, rest.triangles).closest(fine.mesh.nodes).point
    assert np.linalg.norm(moved - fine.mesh.nodes, axis=1).max() < 5e-5
    load = sheet.gauge_pressure_pa * fine.mesh.areas.mean()
    assert np.abs(fine.rest_force[fine.mesh.free]).max() < 1e-6 * load
    assert fine.mean_tension == pytest.approx(sheet.tension_n_per_m, rel=2e-3)


def test_report_files(study, tmp_path):
    accuracy_report.write(study, tmp_path)
    with (tmp_path / "accuracy.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(study.rows)
    assert {"depth_m", "warm_ms", "cop_error_m", "gas_error_pa"} <= set(lines[0])
    data = json.loads((tmp_path / "accuracy.json").read_text())
    assert {
        "targets",
        "curves",
        "points",
        "materials",
        "baselines",
        "rows",
        "grid",
        "omitted",
    } == set(data)
    assert any(point["on_front"] for point in data["points"])
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="exists"):
        check_free(tmp_path, accuracy_report.FILES)


def row(setup, ms, overlap, force, **changed):
    known = Row(
        "sensor", False, "sphere", False, 0.015, 0.3, "1 %", setup, "x", 800, 1, 2, 0.01, 0.003,
        5.0, "ok", 0, overlap, overlap, overlap, force, force, 0.0, 1.0, 1e-3, 1e-4, 1.0, 0.0,
        100.0, ms,
    )  # fmt: skip
    return replace(known, **changed)


def test_front_and_targets_on_known_rows(study):
    setups = tuple(Setup(s) for s in ("a", "b", "c"))
    rows = [row("a", 5, 0.8, 0.01), row("b", 9, 0.7, 0.02), row("c", 3, 0.6, 0.03)]
    known = replace(study, grid=replace(GRID, setups=setups), rows=rows, baselines=[])
    front = {p.setup: p.on_front for p in accuracy_report.points(known)}
    assert front == {"a": True, "b": False, "c": True}
    assert all(t.met for t in accuracy_report.targets(known))
    worse = replace(known, rows=[row("a", 5, 0.1, 0.051), row("a", 5, 0.1, np.nan, failed=2)])
    found = accuracy_report.targets(worse)
    assert len(found) == 4 and not any(t.met for t in found)
    learnt = replace(known, rows=[row("a", 5, 0.8, 0.029, identified=True)])
    assert all(t.met for t in accuracy_report.targets(learnt))


def test_edges_of_known_rows(study):
    rows = [
        row("a", 5, 0.8, 0.01),
        row("a", 5, 0.6, 0.01, object_name="ring", area_error_relative=0.1),
        row("a", 5, np.nan, np.nan, object_name="ell", failed=1),
    ]
    known = replace(study, rows=rows, baselines=[])
    own, others, *each = edge_report.edges(known)
    assert (own.presses, own.failed, own.iou, own.iou_worst) == (1, 1, 0.6, 0.6)
    assert (others.objects, others.iou) == ("others", 0.8)
    assert [edge.objects for edge in each] == ["sphere", "ring", "ell"]
    met = {target.name: target.met for target in edge_report.targets(known)}
    assert met["study's own, 1 %: mean IoU"] is False
    assert met["others, 1 %: mean IoU"] is True
    assert met["study's own, 1 %: |mean area error|"] is False
    assert "study's own" in edge_report.to_text(known)


def test_curves_tell_median_worst_and_what_has_no_answer(study):
    grid = replace(GRID, setups=(Setup("a"),))
    rows = [row("a", 5, 0.8, e) for e in (0.01, 0.02, 0.09)] + [row("a", 5, 0, np.nan, failed=1)]
    (curve,) = accuracy_report.curves(replace(study, grid=grid, rows=rows))
    assert (curve.presses, curve.failed) == (4, 1)
    assert curve.force_error_relative_median == 0.02
    assert curve.force_error_relative_worst == 0.09


def test_products_are_the_whole_way_to_the_patch():
    assert {"estimate", "patch", "pixel_mask"} == PRODUCTS
