"""Pose against other registration methods."""

import os

import numpy as np

from benchmarks.cloud_registration import CloudRegistration, has_small_gicp
from benchmarks.pose_rivals import BOTH, WHOLE_CLOUD, PoseGrid, rivals_study
from bubbleviz.membrane import ObjectSurface
from bubbleviz.pose import moved
from bubbleviz.simulation import study_object

LONG = "TEST_ALL" in os.environ
"""Else fewer presses on coarser meshes, which are not judged by their errors."""
GRID = PoseGrid(
    objects=("cross",), poses=2 if LONG else 1, noises_relative=(0.01,), truth_nodes=1_500, seed=5
)


def test_rival_methods_register_a_complete_surface():
    model = ObjectSurface(study_object("frustum"))
    points, _ = model.sample(2_000, seed=8)
    T = np.eye(4)
    T[:3, 3] = [0.01, 0.0, 0.04]
    start = moved(T, np.array([1e-3, 1e-3, -1e-3, 0.03, 0.02, -0.03]), T[:3, 3])
    rival = CloudRegistration(model, 0.01)
    there = points + T[:3, 3]
    ways = [rival.open3d, *([rival.small_gicp] if has_small_gicp() else [])]
    for way in ways:
        assert np.abs(way(there, start) - T).max() < 5e-3


def test_every_method_has_the_same_initial_pose(sensor):
    study = rivals_study(sensor, GRID).run()
    methods = {trial.method for trial in study.rows}
    assert {WHOLE_CLOUD, "stage one", BOTH, "patch, Open3D"} <= methods
    assert len(study.rows) == GRID.poses * len(methods)
    own = [trial for trial in study.rows if trial.method == BOTH]
    for trial in own:
        assert trial.status == "ok"
        assert trial.start_m <= 5e-3
        assert trial.start_rad <= np.radians(10.0)
        assert trial.error_m < 1e-3
        assert trial.error_rad < np.radians(2.0)
        assert trial.total_ms > 0.0
    assert study.omitted == []
    names = [target.name for target in study.targets]
    assert "cross, 1 %: better than whole cloud" in names
    assert "both stages" in study.to_text() and "cross" in study.to_text()
