"""Error, coverage of the 95 % ellipsoid and time of tracked poses, at rest and moving.

Beside them the libraries Open3D and small_gicp, which register the same contact points by
point-to-plane ICP from the pose of the frame before.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from bubbleviz.inverse import EstimatorOptions
from bubbleviz.membrane import ObjectSurface
from bubbleviz.pipeline import Pipeline
from bubbleviz.pose import PoseTracker, contact_points, motion_between, precision_of
from bubbleviz.recordings import Frame
from bubbleviz.result import Pose
from bubbleviz.sensor import Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    LINEAR_NODES,
    DepthNoise,
    LinearPresses,
    Press,
    Presses,
    RubberPresses,
    SimulatedPress,
    rubber_sensor,
    study_object,
)
from bubbleviz.study.harness import (
    Averages,
    Case,
    Column,
    Report,
    Study,
    Table,
    Target,
    at_least,
    at_most,
    averages,
    summaries,
)
from bubbleviz.study.pose import PoseErrors, PoseMetrics, TrueContact, wrong_pose

_RATE_HZ, _SWING_HZ = 30.0, 0.7
_SWING_M, _SWING_RAD = 2e-3, np.radians(12.0)
"""A moving object slides by ±2 mm and turns by ±12° about the vertical, 0.7 times a second: up to
9 mm/s and 53°/s."""
_MIN_DEPTH_M, _MAX_DEPTH_M = 0.007, 0.012  # as in the study of poses
_LIMIT = chi2(6).ppf(0.95)
LEAST, MOST = 0.90, 0.98
"""Share of the ellipsoids that should contain the true pose."""


@dataclass(frozen=True)
class Grid:
    """Classes of poses; each has `paths` times `seeds` rows."""

    objects: tuple[str, ...] = ("cylinder", "frustum", "hex_nut", "two_legged_toy", "torus")
    materials: tuple[str, ...] = ("linear",)  # or "rubber", of which a press takes minutes
    noises: tuple[tuple[float, float], ...] = ((1.5e-4, 0.0), (0.0, 0.01))  # m, and relative
    frames: int = 20  # of a track; the last one counts
    paths: int = 5  # random poses, and motions, of each object
    seeds: int = 10  # of noise and initial pose, on each path
    truth_nodes: int = LINEAR_NODES  # of the linear membrane
    seed: int = 7


@dataclass(frozen=True)
class PoseRow(PoseErrors):
    """The last frame of one track. Errors are modulo symmetry."""

    object_name: str
    material: str
    noise: str
    motion: str  # "at rest" or "moving"
    status: str
    distance2: float = np.inf  # squared Mahalanobis distance of the true pose
    # processor time of the pose: median over all but the first frame, and what 95 % take less than;
    # a library's for the last frame
    median_ms: float = np.nan
    slow_ms: float = np.nan
    method: str = "bubbleviz"  # or a library

    @property
    def lost(self) -> bool:
        return self.status != "ok"

    @property
    def covered(self) -> float:
        """Whether the 95 % ellipsoid contains the true pose; NaN for a library, which has none."""
        return float(self.distance2 <= _LIMIT) if self.method == PoseRow.method else np.nan


def coverage_study(sensor: Sensor, grid: Grid, parts: Path | None = None) -> Study:
    """Every object on every material at every noise, at rest and moving."""
    benches = {material: _Bench(sensor, material, grid) for material in grid.materials}
    cases = [
        Case(f"{name} {material} {path}", partial(benches[material].rows, name, path))
        for material, name, path in product(grid.materials, grid.objects, range(grid.paths))
    ]
    return Study("pose_coverage", PoseRow, cases, report_of, asdict(grid), parts)


def poses_of(press: Press, presses: Presses, grid: Grid, path: int) -> np.ndarray:
    """Poses T_B_O (F, 4, 4) of a moving object; the first is that of the object at rest."""
    T = press.pose(presses.mesh, grid.seed)
    phases = np.random.default_rng([grid.seed, path]).uniform(0.0, 2.0 * np.pi, 3)
    t = np.arange(grid.frames) / _RATE_HZ
    swing = np.sin(2.0 * np.pi * _SWING_HZ * t[:, None] + phases) - np.sin(phases)
    poses = np.tile(T, (grid.frames, 1, 1))
    turn = Rotation.from_rotvec(_SWING_RAD * swing[:, 2:] * [0.0, 0.0, 1.0])
    poses[:, :3, :3] = turn.as_matrix() @ T[:3, :3]
    poses[:, :2, 3] += _SWING_M * swing[:, :2]
    return poses


class _Bench:
    """Tracks objects on one membrane."""

    def __init__(self, sensor: Sensor, material: str, grid: Grid) -> None:
        self._grid, self._material = grid, material
        model = SensorModel.of(rubber_sensor(sensor) if material == "rubber" else sensor)
        self._pipeline = Pipeline(model, EstimatorOptions.named(material))
        self._presses: Presses = (
            RubberPresses.of(model)
            if material == "rubber"
            else LinearPresses.of(model, grid.truth_nodes)
        )

    def rows(self, name: str, path: int) -> list[PoseRow]:
        """Rows of one path at every noise, at rest and moving."""
        grid, obj = self._grid, study_object(name)
        random = np.random.default_rng([grid.seed, path, *name.encode()])
        press = Press(name, float(random.uniform(_MIN_DEPTH_M, _MAX_DEPTH_M)), False)
        poses = poses_of(press, self._presses, grid, path)
        solved = cache(lambda k: self._presses.press(obj, poses[k]))
        model = ObjectSurface(obj)
        metrics = PoseMetrics(model, precision_of(self._pipeline.estimator))
        others, rows = libraries(model), []
        for moving, (absolute_m, relative) in product((False, True), grid.noises):
            noise = DepthNoise(relative=relative, absolute_m=absolute_m)
            text = f"{100 * relative:g} %" if relative else f"{1e3 * absolute_m:g} mm"
            motion = "moving" if moving else "at rest"
            base = PoseRow(name, self._material, text, motion, "none")
            truths = [solved(k if moving else 0) for k in range(grid.frames)]
            last = truths[-1].truth
            touched = truths[-1].mesh, last.displacement_3d_m, last.contact_pressure_pa
            true = metrics.touching(*touched, truths[-1].T_B_O)
            for seed in range(grid.seeds):
                pose, times, before, points = self._tracked(model, truths, noise, seed, random)
                rows.append(_row(base, pose, times, metrics, true))
                for method, register in others.items():
                    row = replace(base, method=method, status=pose.status)
                    if pose.status == "ok":
                        began = time.process_time()
                        T_B_O = register(points, before)
                        ms = 1e3 * (time.process_time() - began)
                        errors = vars(metrics.errors(T_B_O, true))
                        row = replace(row, **errors, median_ms=ms, slow_ms=ms)
                    rows.append(row)
        return rows

    def _tracked(
        self,
        model: ObjectSurface,
        truths: Sequence[SimulatedPress],
        noise: DepthNoise,
        seed: int,
        random: np.random.Generator,
    ) -> tuple[Pose, np.ndarray, np.ndarray, np.ndarray]:
        """Pose in the last frame from a wrong initial one, and processor times (F − 1,), ms.

        Also the pose T_B_O (4, 4) before, and the contact points (k, 3) of the last frame.
        """
        start = wrong_pose(truths[0].T_B_O, truths[0].T_B_O[:3, 3], random)
        pipeline, times, found = self._pipeline, [], [start]
        pipeline.restart()
        tracker = PoseTracker(pipeline.estimator, model.obj, start, membrane=pipeline.model.rubber)
        for k, truth in enumerate(truths):
            own = 1_000 * self._grid.seed + seed
            depth = noise.depth_image(pipeline.camera, truth.range_m, own, k)
            result = pipeline.process(
                Frame(k, k / _RATE_HZ, depth), frozenset({"estimate", "patch"})
            )
            assert result.estimate is not None and result.patch is not None
            began = time.process_time()
            pose = tracker.update(result.frame, result.estimate, result.patch)
            times.append(1e3 * (time.process_time() - began))
            found.append(pose.T_B_O if pose.status == "ok" else found[-1])
            contact = contact_points(pipeline.mesh, result.estimate, result.patch)
        points = np.zeros((0, 3)) if contact is None else contact.points
        return pose, np.array(times[1:]), found[-2], points


Registration = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""T_B_O (4, 4) from points (k, 3) in B and an initial T_B_O."""
_SAMPLES, _ICP_STEPS = 20_000, 60  # points of the object that a library registers to; at most
_ICP_REACH_M = 0.010  # longest correspondence


def libraries(model: ObjectSurface) -> dict[str, Registration]:
    """Point-to-plane ICP of other libraries, by name; small_gicp where it is installed."""
    from open3d import geometry, utility
    from open3d.pipelines import registration as o3d

    points, normals = model.sample(_SAMPLES)
    cloud = geometry.PointCloud(utility.Vector3dVector(points))
    cloud.normals = utility.Vector3dVector(normals)
    plane, ends = o3d.TransformationEstimationPointToPlane(), o3d.ICPConvergenceCriteria
    most = ends(max_iteration=_ICP_STEPS)

    def open3d(seen: np.ndarray, start: np.ndarray) -> np.ndarray:
        source = geometry.PointCloud(utility.Vector3dVector(seen))
        T_O_B = np.linalg.inv(start)
        found = o3d.registration_icp(source, cloud, _ICP_REACH_M, T_O_B, plane, most)
        return np.linalg.inv(found.transformation)

    ways: dict[str, Registration] = {"Open3D": open3d}
    if importlib.util.find_spec("small_gicp"):
        import small_gicp

        target: Any = small_gicp.PointCloud(points)
        tree = small_gicp.KdTree(target)
        small_gicp.estimate_normals_covariances(target, tree, num_neighbors=12)

        def gicp(seen: np.ndarray, start: np.ndarray) -> np.ndarray:
            found = small_gicp.align(
                target,
                small_gicp.PointCloud(seen),
                tree,
                init_T_target_source=np.linalg.inv(start),
                registration_type="PLANE_ICP",
                max_correspondence_distance=_ICP_REACH_M,
                num_threads=1,
                max_iterations=_ICP_STEPS,
            )
            return np.linalg.inv(found.T_target_source)

        ways["small_gicp"] = gicp
    return ways


def _row(
    base: PoseRow,
    pose: Pose,
    times: np.ndarray,
    metrics: PoseMetrics,
    true: TrueContact,
) -> PoseRow:
    slow = float(np.quantile(times, 0.95))
    row = replace(base, status=pose.status, median_ms=float(np.median(times)), slow_ms=slow)
    if pose.status != "ok":
        return row
    equivalents = metrics.equivalents(pose.T_B_O, true)
    origin = pose.T_B_O[:3, 3]
    off = np.array([motion_between(pose.T_B_O, T, origin) for T in equivalents])
    distance2 = np.einsum("si,si->s", off, np.linalg.solve(pose.covariance, off.T).T).min()
    return replace(row, **vars(metrics.errors(pose.T_B_O, true)), distance2=float(distance2))


_CLASS = ("object_name", "material", "noise", "motion", "method")
_OF: Averages = averages("error_m", "whole_m", "whole_rad", "median_ms") | {
    "lost": ("lost", np.sum),
    "covered": ("covered", np.mean),
    "slow_ms": ("slow_ms", lambda times: np.quantile(times, 0.95)),
}
_COLUMNS = (
    Column("object", "object_name"),
    *(Column(name, name) for name in _CLASS[1:]),
    Column("mm", "error_m", ".2f", 1e3),
    Column("all mm", "whole_m", ".2f", 1e3),
    Column("all °", "whole_rad", ".1f", float(np.degrees(1.0))),
    Column("covered %", "covered", ".0f", 100),
    Column("lost", "lost", ".0f"),
    Column("tracks", "count"),
    Column("ms", "median_ms", ".1f"),
    Column("95 % ms", "slow_ms", ".1f"),
)


def report_of(rows: list[PoseRow]) -> Report:
    """Coverage, errors along the determined directions and along all, and times."""
    found = summaries(rows, _CLASS, _OF)
    targets: list[Target] = []
    for one in (each for each in found if each["method"] == PoseRow.method):
        name = ", ".join(one[key] for key in _CLASS[:-1])
        targets += [
            at_least(f"{name}: covered", one["covered"], LEAST),
            at_most(f"{name}: covered", one["covered"], MOST),
        ]
    return Report([Table("points", found, _COLUMNS)], targets)
