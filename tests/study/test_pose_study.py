"""The pose study: judge, rivals, structure, screw motion and report."""

import csv
import json
import os

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.pipeline import Pipeline
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.rigid_motion import moved
from bubbleviz.pose.tracker import precision_of
from bubbleviz.sensor import load_sensor
from bubbleviz.simulation.synthetic_source import SyntheticSource
from bubbleviz.study.pose import pose_report
from bubbleviz.study.pose.cloud_registration import CloudRegistration, has_small_gicp
from bubbleviz.study.pose.pose_errors import PoseJudge
from bubbleviz.study.pose.pose_study import BOTH, WHOLE_CLOUD, PoseGrid, run_pose_study
from bubbleviz.study.pose.rubber_poses import RubberGrid, run_rubber_study
from bubbleviz.study.pose.screw_motion import run_screw, screw_path, screw_source
from bubbleviz.study.presses import Press, made

LONG = "TEST_ALL" in os.environ
"""Else fewer presses on coarser meshes, which are not judged by their errors."""
GRID = PoseGrid(
    objects=("cross",), poses=2 if LONG else 1, noises_relative=(0.01,), truth_nodes=1_500, seed=5
)


@pytest.fixture(scope="module")
def sensor():
    return load_sensor("pico_flexx_75mm")


@pytest.fixture(scope="module")
def study(sensor):
    return run_pose_study(sensor, GRID)


def test_judge_of_a_flat_face(sensor):
    pipeline = Pipeline.of(sensor)
    true_pose = Press("frustum", 0.012, False).pose(pipeline.mesh, 5)
    source = SyntheticSource(sensor, made("frustum"), true_pose[None], nodes=1_500)
    judge = PoseJudge(ObjectModel(made("frustum")), precision_of(pipeline.estimator))
    true = judge.contact(source)
    center = true.center
    assert true.directions.determined.sum() == 3
    exact = judge.errors(true_pose, true)
    assert exact.whole_m < 1e-9
    assert exact.success
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
    assert not errors.success


def test_rivals_find_a_whole_surface_again():
    model = ObjectModel(made("frustum"))
    points, _ = model.sample(2_000, seed=8)
    T = np.eye(4)
    T[:3, 3] = [0.01, 0.0, 0.04]
    start = moved(T, np.array([1e-3, 1e-3, -1e-3, 0.03, 0.02, -0.03]), T[:3, 3])
    rival = CloudRegistration(model, 0.01)
    there = points + T[:3, 3]
    ways = [rival.open3d, *([rival.small_gicp] if has_small_gicp() else [])]
    for way in ways:
        assert np.abs(way(there, start) - T).max() < 5e-3


def test_structure(study):
    methods = {trial.method for trial in study.trials}
    assert {WHOLE_CLOUD, "stage one", BOTH, "patch, Open3D"} <= methods
    assert len(study.trials) == GRID.poses * len(methods)
    own = [trial for trial in study.trials if trial.method == BOTH]
    for trial in own:
        assert trial.status == "ok"
        assert trial.start_m <= 5e-3
        assert trial.start_rad <= np.radians(10.0)
        assert trial.error_m < 1e-3
        assert trial.error_rad < np.radians(2.0)
        assert trial.total_ms > 0.0
    assert study.omitted == []


@pytest.fixture(scope="module")
def screw(sensor):
    """The first frames of the nut that is turned."""
    if not LONG:
        sensor = with_nodes(sensor, 400)
    source = screw_source(sensor, nodes=2_000 if LONG else 800)
    source.poses = source.poses[:4]
    return run_screw(sensor, source, 3, blanked=False)


@pytest.mark.long
def test_the_nut_turns_by_sixty_degrees(screw):
    poses = screw_path(0.05, 0.013, 120)
    turned = Rotation.from_matrix(poses[-1][:3, :3] @ poses[0][:3, :3].T)
    assert np.degrees(turned.magnitude()) == pytest.approx(60.0)
    assert screw.status == {"ok": 4}
    assert screw.recovered_after is None
    assert screw.rotation_error_rad_end < np.radians(6.0)


def with_nodes(sensor, nodes):
    membrane = sensor.membrane.model_copy(update={"nodes": nodes})
    return sensor.model_copy(update={"membrane": membrane})


OBJECTS = ("cylinder", "two_spheres") if LONG else ("two_spheres",)
"""What is pressed into rubber; a flat face takes as long again."""


@pytest.fixture(scope="module")
def rubber(sensor):
    """A pair of balls, and a flat puck, on a coarse sensor, truth by the exact forward model."""
    grid = RubberGrid(
        objects=OBJECTS, presses=1, starts=1, truth_nodes=1_500 if LONG else 600, seed=11,
        noise_relative=0.003,
    )  # fmt: skip
    return run_rubber_study(with_nodes(sensor, 1_200 if LONG else 400), grid)


@pytest.mark.long
def test_on_rubber_flat_faces_and_balls_are_where_they_are(rubber):
    assert rubber.omitted == []
    for trial in rubber.trials:
        assert trial.status == "ok"
        assert trial.depth_m >= 7e-3
        assert trial.seen_m < 1e-3
        assert trial.seen_rad < np.radians(3.0)


def test_report(study, rubber, screw, tmp_path):
    report = pose_report.PoseReport(study, rubber, [screw])
    paths = pose_report.write(report, tmp_path)
    assert [path.name for path in paths] == list(pose_report.FILES)
    data = json.loads(paths[2].read_text())
    assert {"targets", "points", "screws", "trials", "grid"} <= set(data)
    names = [target["name"] for target in data["targets"]]
    assert "cross, 1 %: better than whole cloud" in names
    assert "screw, 1 runs: largest rotation error in °, worst run" in names
    with paths[0].open() as file:
        assert len(list(csv.DictReader(file))) == len(study.trials)
    assert f"rubber, {len(OBJECTS)} starts: worst error in mm" in names
    text = pose_report.to_text(report)
    assert "both stages" in text
    assert "cross" in text
