"""Coverage of tracked poses: of known rows, and of a small run."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.pose_coverage import Grid, PoseRow, coverage_study, libraries, report_of
from bubbleviz.membrane import ObjectSurface
from bubbleviz.pose import moved
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation import study_object
from tests.membrane.domes import pose

SMALL = Grid(
    objects=("frustum",), noises=((1.5e-4, 0.0),), frames=5, paths=1, seeds=1, truth_nodes=4_000
)


def test_coverage_of_known_rows():
    what = "nut", "linear", "1 %", "moving"
    inside = PoseRow(*what, "ok", 12.5, 8.0, 20.0, error_m=1e-4, whole_m=2e-4, whole_rad=0.1)
    outside, lost = replace(inside, distance2=12.7), PoseRow(*what, "lost")
    (table,) = report_of([*18 * [inside], outside, lost]).tables
    (one,) = table.records
    assert (one["count"], one["lost"]) == (20, 1)
    assert one["covered"] == pytest.approx(0.9)
    assert one["whole_m"] == pytest.approx(2e-4)
    assert all(target.met for target in report_of([*18 * [inside], outside, lost]).targets)
    assert not all(target.met for target in report_of([inside, outside]).targets)


def test_libraries_register_a_complete_surface():
    model = ObjectSurface(study_object("frustum"))
    points, _ = model.sample(2_000, seed=8)
    T = pose(0.01, 0.0, 0.04)
    start = moved(T, np.array([1e-3, 1e-3, -1e-3, 0.03, 0.02, -0.03]), T[:3, 3])
    for register in libraries(model).values():
        assert np.abs(register(points + T[:3, 3], start) - T).max() < 5e-3


@pytest.mark.long
def test_poses_of_a_small_run():
    study = coverage_study(load_sensor("pico_flexx_75mm"), SMALL).run()
    assert study.omitted == []
    own = [row for row in study.rows if row.method == "bubbleviz"]
    assert [row.motion for row in own] == ["at rest", "moving"]
    assert {"bubbleviz", "Open3D"} <= {row.method for row in study.rows}
    for row in own:
        assert row.status == "ok"
        assert row.error_m < 2e-4
        assert row.whole_m < 1e-3
        assert np.isfinite(row.distance2)
