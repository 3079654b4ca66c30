"""Error and coverage of the tracked poses of objects that rubber of another solver sticks to.

The recordings of `tests.rubber_renders`: a ball and a round puck are pressed in, then dragged and
twisted. The sensor is identified from its own inflation levels and open chamber.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import bubbleviz as bv
from bubbleviz.errors import InputError
from bubbleviz.membrane import MembraneMesh, ObjectSurface
from bubbleviz.pipeline import Pipeline
from bubbleviz.pose import PoseTracker, motion_between, precision_of
from bubbleviz.recordings import HeldFrames
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import load_sensor
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
from bubbleviz.study.pose import PoseErrors, PoseMetrics, wrong_pose
from tests import rubber_renders as renders

WORST_M, WORST_RAD = 3e-4, np.radians(1.5)
"""Limits of errors along the directions that the contact's normals determine; as asked."""
COVERED = 0.90  # least share of the ellipsoids that should contain the true pose
_LEAST_AREA_M2 = 3e-5  # of the patch, from which on the object is tracked
_CALIBRATION_M = 5e-5  # noise of the frames that the sensor is identified from


@dataclass(frozen=True)
class Grid:
    """Recordings, each with `seeds` images of every noise."""

    names: tuple[str, ...] = ("ball_drag1", "puck_twist")
    noises_m: tuple[float, ...] = (5e-5, 1.5e-4, 6.5e-4)  # the last is 1 % of the range
    seeds: int = 4
    every: int = 1  # frame of a recording
    camera_px: int = 640  # width of the images


@dataclass(frozen=True)
class DraggedRow(PoseErrors):
    """One frame."""

    name: str
    noise_m: float
    seed: int
    frame: int
    status: str
    # squared Mahalanobis distance of the true pose over its 95 % quantile
    distance2: float = np.inf
    told_m: float = np.inf  # error over the directions that the pose itself calls determined

    @property
    def lost(self) -> bool:
        return self.status != "ok"

    @property
    def covered(self) -> bool:
        """Whether the 95 % ellipsoid contains the true pose."""
        return self.distance2 <= 1.0


def dragged_study(grid: Grid) -> Study:
    """Every recording at every noise.

    Raises InputError: this machine does not have the recordings.
    """
    for name in grid.names:
        if not (path := renders.FOLDER / f"{name}.npz").is_file():
            raise InputError(f"{path}: not on this machine; put data/rubber_truth there")
    bench = _Bench(grid)
    cases = [
        Case(f"{name} {1e3 * noise_m:g} mm {seed}", partial(bench.rows, name, noise_m, seed))
        for name, noise_m, seed in product(grid.names, grid.noises_m, range(grid.seeds))
    ]
    return Study("pose_dragged", DraggedRow, cases, report_of, asdict(grid))


def _ball() -> RigidObject:
    mesh = trimesh.creation.icosphere(5, 0.01)
    return RigidObject("ball", np.asarray(mesh.vertices), np.asarray(mesh.faces))


def _puck() -> RigidObject:
    """9 mm in radius, with an edge rounded by 1.5 mm: so its nodes in and out of contact show."""
    angle = np.linspace(0.0, 0.5 * np.pi, 13)
    edge = np.column_stack([7.5e-3 + 1.5e-3 * np.sin(angle), 1.5e-3 * (1.0 - np.cos(angle))])
    face, side = [[0.0, 0.0], [2.5e-3, 0.0], [5e-3, 0.0]], [[9e-3, 5e-3], [9e-3, 0.01], [0.0, 0.01]]
    mesh = trimesh.creation.revolve(np.concatenate([face, edge, side]), sections=128)
    return RigidObject("puck", np.asarray(mesh.vertices), np.asarray(mesh.faces))


_OBJECTS = {"ball_drag1": (_ball, np.eye(3)), "puck_twist": (_puck, np.eye(3)[2:])}
"""Object of each recording, and axes (q, 3) in O through its origin about which it is round."""


class _Bench:
    """Tracks objects on one sensor."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        focal_px = 215.0 * grid.camera_px / 320.0
        self._camera = renders.camera_of(grid.camera_px, focal_px)

    @cached_property
    def _pipeline(self) -> Pipeline:
        """Of the identified sensor."""
        truth, camera = renders.rubber_truth(self._grid.names[0]), self._camera

        def still(name: str, shape: np.ndarray, gauge_pa: float, frames: int) -> HeldFrames:
            shapes, triangles = renders.at_rest(shape, frames), truth["triangles"]
            return renders.render(name, camera, shapes, triangles, gauge_pa, noise_m=_CALIBRATION_M)

        levels = [
            still("level", shape, gauge_pa, 10)
            for shape, gauge_pa in zip(truth["level_m"], truth["level_pa"], strict=True)
        ]
        rest = still("rest", truth["rest_m"], renders.GAUGE_PA, 30)
        vented = still("vented", truth["vented_m"], 0.0, 5)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "dome.toml"
            drawn = renders.dome_sensor(camera)
            bv.identify(rest, drawn, levels=levels, vented=vented).save(path)
            return Pipeline.of(load_sensor(path))

    def rows(self, name: str, noise_m: float, seed: int) -> list[DraggedRow]:
        """Frames of one recording, tracked from the first patch that is large enough."""
        pipeline, every = self._pipeline, self._grid.every
        truth, (make, axes) = renders.rubber_truth(name), _OBJECTS[name]
        poses = np.tile(np.eye(4), (len(truth["nodes_m"]), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = truth["object_rotation"], truth["object_position_m"]
        shapes, gauges = truth["nodes_m"][::every], truth["gauge_pressure_pa"][::every]
        images = renders.render(
            name, self._camera, shapes, truth["triangles"], gauges, noise_m=noise_m, seed=seed
        )
        obj, tracker, found = make(), None, []
        metrics = PoseMetrics(ObjectSurface(obj), precision_of(pipeline.estimator))
        random = np.random.default_rng(seed)
        pipeline.restart()
        for k in range(len(shapes)):
            number = every * k
            result = pipeline.process(images[k], frozenset({"estimate", "patch"}))
            assert result.estimate is not None and result.patch is not None
            if tracker is None:
                if result.patch.area_m2 < _LEAST_AREA_M2:
                    continue
                start = wrong_pose(poses[number], poses[number, :3, 3], random)
                rubber = pipeline.model.rubber
                tracker = PoseTracker(pipeline.estimator, obj, start, membrane=rubber)
            pose = tracker.update(result.frame, result.estimate, result.patch)
            row = DraggedRow(name, noise_m, seed, number, pose.status)
            if pose.status == "ok":
                nodes, T = shapes[k], _unturned(pose.T_B_O, poses[number], axes)
                mesh = MembraneMesh(nodes, truth["triangles"], np.zeros(len(nodes), bool))
                touching = truth["touching"][number].astype(float)
                true = metrics.touching(mesh, np.zeros_like(nodes), touching, poses[number])
                off = metrics.errors(T, true)
                if len(axes) == 3:  # a ball, whose centre is determined, all of it
                    off = replace(off, error_m=off.whole_m, error_rad=off.whole_rad)
                distance2 = _distance2(T, poses[number], pose.covariance, axes)
                told = motion_between(T, poses[number], pose.center_m)
                told = np.linalg.solve(pose.motions, told) * pose.determined
                told_m = float(np.linalg.norm((pose.motions @ told)[:3]))
                row = replace(row, **vars(off), told_m=told_m, distance2=distance2)
            found.append(row)
        return found


def _unturned(T_B_O: np.ndarray, true: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The equivalent pose (4, 4), turned about the axes (q, 3), that is closest to the true one."""
    turn = Rotation.from_matrix(T_B_O[:3, :3].T @ true[:3, :3]).as_quat()
    turn[:3] = turn[:3] @ axes.T @ axes
    turned = T_B_O.copy()
    turned[:3, :3] = T_B_O[:3, :3] @ Rotation.from_quat(turn).as_matrix()
    return turned


def _distance2(
    T_B_O: np.ndarray,
    true: np.ndarray,
    covariance: np.ndarray,
    axes: np.ndarray,
) -> float:
    """Squared Mahalanobis distance over its 95 % quantile, where turns about the axes are free."""
    origin, information = T_B_O[:3, 3], np.linalg.inv(covariance)
    off, turns = motion_between(T_B_O, true, origin), axes @ true[:3, :3].T
    free = np.hstack([np.cross(turns, origin - true[:3, 3]), turns])
    pulled = free @ information
    off = off - free.T @ np.linalg.solve(pulled @ free.T, pulled @ off)
    return float(off @ information @ off / chi2(6 - len(axes)).ppf(0.95))


_OF: Averages = averages("error_m", "error_rad", "told_m") | {
    "error_m_worst": ("error_m", np.max),
    "error_rad_worst": ("error_rad", np.max),
    "lost": ("lost", np.sum),
    "covered": ("covered", np.mean),
}
_DEGREES = float(np.degrees(1.0))
_COLUMNS = (
    Column("recording", "name"),
    Column("noise mm", "noise_m", ".2f", 1e3),
    Column("mm", "error_m", ".2f", 1e3),
    Column("worst", "error_m_worst", ".2f", 1e3),
    Column("told mm", "told_m", ".2f", 1e3),
    Column("°", "error_rad", ".1f", _DEGREES),
    Column("worst", "error_rad_worst", ".1f", _DEGREES),
    Column("covered %", "covered", ".0f", 100),
    Column("lost", "lost", ".0f"),
    Column("frames", "count"),
)


def report_of(rows: list[DraggedRow]) -> Report:
    """Errors along the determined directions, coverage, frames lost."""
    found, targets = summaries(rows, ("name", "noise_m"), _OF), list[Target]()
    for one in found:
        name = f"{one['name']}, {1e3 * one['noise_m']:g} mm"
        targets += [
            at_most(f"{name}: lost", one["lost"], 0.0),
            at_most(f"{name}: worst error, mm", 1e3 * one["error_m_worst"], 1e3 * WORST_M),
            at_most(
                f"{name}: worst error, °", _DEGREES * one["error_rad_worst"], _DEGREES * WORST_RAD
            ),
            at_least(f"{name}: covered", one["covered"], COVERED),
        ]
    return Report([Table("points", found, _COLUMNS)], targets)
