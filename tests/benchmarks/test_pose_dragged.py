"""Poses of dragged objects: of known rows, and of a few frames."""

from dataclasses import replace

import pytest

from benchmarks.pose_dragged import DraggedRow, Grid, dragged_study, report_of
from tests.rubber_renders import rubber_truth


def test_targets_of_known_rows():
    good = DraggedRow("ball", 5e-5, 0, 3, "ok", 0.5, error_m=1e-4, error_rad=0.01)
    wide = replace(good, error_m=4e-4, error_rad=0.0, distance2=1.5)
    lost = DraggedRow("ball", 5e-5, 0, 5, "lost")
    assert all(target.met for target in report_of([good]).targets)
    (table,) = report_of([good, good, wide]).tables
    (one,) = table.records
    assert one["error_m"] == pytest.approx(1e-4)
    assert one["error_m_worst"] == pytest.approx(4e-4)
    assert one["covered"] == pytest.approx(2 / 3)
    met = [target.met for target in report_of([good, good, wide]).targets]
    assert met == [True, False, True, False]
    assert not report_of([good, lost]).targets[0].met


@pytest.mark.long
def test_a_dragged_ball_is_where_it_is():
    rubber_truth("ball_drag1")  # skips without it
    grid = Grid(("ball_drag1",), (1.5e-4,), seeds=1, every=6, camera_px=320)
    (track,) = [dragged_study(grid).run().rows]
    assert len(track) >= 3
    assert all(row.status == "ok" and row.error_m < 4e-4 for row in track)


@pytest.mark.long
def test_a_twisted_puck_is_where_it_is():
    """Its blurred contact reaches over the round edge; the depth image determines where that is."""
    rubber_truth("puck_twist")  # skips without it
    (track,) = [dragged_study(Grid(("puck_twist",), (5e-5,), seeds=1, every=3)).run().rows]
    twisted = [row for row in track if row.frame >= 12]
    assert len(twisted) >= 5
    assert all(row.status == "ok" and row.error_m < 2e-4 for row in twisted)
