"""The pose study: judge, small run and report."""

import json
import os

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.membrane import ObjectSurface
from bubbleviz.pipeline import Pipeline
from bubbleviz.pose import moved, precision_of
from bubbleviz.simulation import Press, SyntheticSource, study_object, with_nodes
from bubbleviz.study.pose import Grid, PoseMetrics, pose_study
from tests.program import rows_of

LONG = "TEST_ALL" in os.environ
"""Else fewer presses on coarser meshes, which are not judged by their errors."""
OBJECTS = ("cylinder", "two_spheres") if LONG else ("two_spheres",)
"""What is pressed into rubber; a flat face takes as long again."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pose")


@pytest.fixture(scope="module")
def study(sensor, folder):
    """A pair of balls, and a cylinder, on a coarse sensor; ground truth by the exact model."""
    grid = Grid(
        objects=OBJECTS, presses=1, starts=1, truth_nodes=1_500 if LONG else 400, seed=11,
        noise_relative=0.003,
    )  # fmt: skip
    return pose_study(with_nodes(sensor, 1_200 if LONG else 200), grid).run(folder)


def test_judge_of_a_flat_face(sensor):
    pipeline = Pipeline.of(sensor)
    true_pose = Press("frustum", 0.012, False).pose(pipeline.mesh, 5)
    source = SyntheticSource(sensor, study_object("frustum"), true_pose[None], nodes=1_500)
    judge = PoseMetrics(ObjectSurface(study_object("frustum")), precision_of(pipeline.estimator))
    truth = source.truth(0)
    touched = source.mesh, truth.displacement_3d_m, truth.contact_pressure_pa
    true = judge.touching(*touched, true_pose)
    center = true.center
    assert true.directions.determined.sum() == 3
    exact = judge.errors(true_pose, true)
    assert exact.whole_m < 1e-9
    assert exact.error_m < 1e-9 and exact.error_rad < 1e-6
    # slid 10 mm on its face: no error that contact could see
    along = true_pose[:3, 0]
    slid = moved(true_pose, np.concatenate([0.01 * along, np.zeros(3)]), center)
    errors = judge.errors(slid, true)
    assert errors.error_m < 5e-4
    assert errors.whole_m == pytest.approx(0.01, rel=1e-3)
    # lifted by 4 mm, and turned by its own symmetry
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()
    lifted = moved(true_pose, np.concatenate([4e-3 * true_pose[:3, 2], np.zeros(3)]), center)
    errors = judge.errors(lifted @ quarter, true)
    assert errors.error_m == pytest.approx(4e-3, rel=0.02)
    assert errors.whole_rad < 1e-3


@pytest.mark.long
def test_on_rubber_flat_faces_and_balls_are_where_they_are(study):
    assert study.omitted == []
    for row in study.rows:
        assert row.status == "ok"
        assert row.depth_m >= 7e-3
        assert row.seen_m < 1e-3
        assert row.seen_rad < np.radians(3.0)


def test_report(study, folder):
    data = json.loads((folder / "pose.json").read_text())
    assert {"targets", "points", "rows", "grid"} <= set(data)
    names = [target["name"] for target in data["targets"]]
    assert f"{len(OBJECTS)} starts: worst error in mm" in names
    rows = rows_of(folder / "pose.csv")
    assert [row["object_name"] for row in rows] == list(OBJECTS)
    assert all(float(row["next_ms"]) > 0.0 for row in rows)
    assert "two_spheres" in study.to_text()
