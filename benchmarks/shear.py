"""Error of traction with friction on objects that are pressed in, dragged and twisted.

The truth is the exact membrane on a finer mesh, with an object that sticks to it, or with Coulomb
friction, which the estimator does not model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from bubbleviz.camera import FlowField
from bubbleviz.membrane import MembraneMesh, build_mesh
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.recordings import Frame
from bubbleviz.result import Estimate, Result
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import (
    DepthNoise,
    SyntheticSource,
    press_path,
    study_object,
    touching_height,
)
from bubbleviz.study.accuracy import at_nodes
from bubbleviz.study.harness import (
    Case,
    Column,
    Report,
    Study,
    Table,
    Target,
    at_least,
    at_most,
    over,
)
from tests.oracles.flow_sighting import sighting
from tests.oracles.stuck_press import OFFSET_M, Motion, ShearTruth, pressed, shear_sensor

_DEPTH: frozenset[Product] = frozenset({"patch"})
_SHEAR: frozenset[Product] = frozenset({"traction", "slip"})
DEPTH_NOISE = DepthNoise(absolute_m=5e-5, correlation_px=2.0)
_SLIPPED_M = 1e-4
"""Displacement over the object that counts as slip; chosen: texture noise hides less."""
HEADING = np.array([0.894, 0.447, 0.0])  # direction of the drags, off the mesh's axes; chosen


@dataclass(frozen=True)
class ShearGrid:
    """Cases of the shear study."""

    objects: tuple[tuple[str, float], ...] = (("puck", 0.005), ("sphere", 0.006))  # depth in m
    # ends of steps of one drag, and of one twist after it, begun anew for each object
    drags_m: tuple[float, ...] = (0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025, 0.003, 0.0035, 0.004)
    twists_rad: tuple[float, ...] = tuple(np.radians((0.0, 4.0, 8.0, 12.0, 16.0, 20.0)).tolist())
    # Coulomb's μ of presses that end in the last of the drags, and in the last of the twists
    frictions: tuple[float, ...] = (1.0,)
    frames: int = 32  # of each of these, of which a quarter is the drag or twist
    flow_sigmas_px: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3)
    slip_depths_m: tuple[float, ...] = (0.0025, 0.004, 0.006, 0.010)  # of balls that slip partially
    slip_seeds: int = 3  # noises of the exact flow of each
    truth_nodes: int = 3_000
    seed: int = 7

    @property
    def paths(self) -> tuple[list[Motion], list[Motion]]:
        """One that drags and one that twists."""
        drags = [Motion(drag * HEADING) for drag in self.drags_m]
        return drags, [Motion(np.zeros(3), twist) for twist in self.twists_rad]


def quick_shear_grid() -> ShearGrid:
    """A run of one minute."""
    return ShearGrid(
        objects=(("puck", 0.005),),
        drags_m=(0.0, 0.0005, 0.001),
        twists_rad=(0.0, float(np.radians(5.0))),
        frictions=(1.0,),
        frames=12,
        flow_sigmas_px=(0.03,),
        slip_depths_m=(0.006,),
        slip_seeds=1,
        truth_nodes=2_000,
    )


@dataclass(frozen=True)
class ShearTrial:
    """One frame of one path; errors are lengths of differences over the true force's.

    `depth_*` is by depth only. `friction` is NaN if the object sticks everywhere; `angle_rad` is
    between the forces, `torque_error` of z about the true centre (NaN without a twist), `sigmas`
    the force's error over its standard deviation; `slip` and `true_slip` are the estimated share of
    the patch that slipped, and the true share that did by more than 0.1 mm (NaN without an
    estimate); times are of the processor.
    """

    depth_status: str
    status: str
    depth_force_error: float
    force_error: float
    angle_rad: float
    torque_error: float
    displacement_rms_m: float
    depth_center_error_m: float
    center_error_m: float
    sigmas: float
    slip: float
    true_slip: float
    object_name: str = ""
    friction: float = np.nan
    drag_m: float = np.nan
    twist_rad: float = np.nan
    flow_sigma_px: float = np.nan
    estimate_ms: float = np.nan
    traction_ms: float = np.nan


def shear_study(grid: ShearGrid) -> Study:
    """Every frame of every path at every noise of the flow."""
    cases = [
        Case(f"{name}, {way}", partial(_all_noises, grid, partial(make, grid, name, depth_m, k)))
        for name, depth_m in grid.objects
        for make, ways in ((_sticking, 2), (_sliding, 2 * len(grid.frictions)))
        for k in range(ways)
        for way in [f"{make.__name__.strip('_')} {k}"]
    ]
    return Study("shear", ShearTrial, cases, report_of)


def _all_noises(grid: ShearGrid, make: Callable[[], Iterable[_Moved]]) -> list[ShearTrial]:
    frames = list(make())
    return [t for sigma in grid.flow_sigmas_px for t in _trials(frames, sigma, grid)]


class _Moved(NamedTuple):
    """A frame of a press, and the motion of its object; None before it is pressed in."""

    object_name: str
    motion: Motion | None
    truth: ShearTruth
    friction: float = np.nan
    slipped: float = 0.0  # share of the contact that has slipped since it began; NaN without one


def _sticking(grid: ShearGrid, name: str, depth_m: float, k: int) -> list[_Moved]:
    """Frames of path k of an object that the membrane sticks to."""
    press, path = pressed(shear_sensor(), name, depth_m, grid.truth_nodes), grid.paths[k]
    truths = list(press.along(path))
    return [_Moved(name, motion, truth) for motion, truth in zip(path, truths, strict=True)]


def _sliding(grid: ShearGrid, name: str, depth_m: float, k: int) -> Iterator[_Moved]:
    """Frames of a drag, or a twist, of an object with Coulomb's friction."""
    sensor, friction, nodes = shear_sensor(), grid.frictions[k // 2], grid.truth_nodes // 2
    drag_m, twist_rad = (0.0, grid.twists_rad[-1]) if k % 2 else (grid.drags_m[-1], 0.0)
    obj, mesh, aim = study_object(name), build_mesh(sensor, nodes), np.eye(4)
    aim[:2, 3] = OFFSET_M
    aim[2, 3] = touching_height(obj, aim, mesh) - depth_m
    poses = press_path(obj, aim, mesh, grid.frames, drag_m, twist_rad)
    source = SyntheticSource(sensor, obj, poses, nodes=nodes, friction=friction)
    slipped_m = np.zeros(len(mesh.nodes))
    for index, pose in enumerate(poses):
        contact, slip_m = source.contact(index), np.asarray(source.truth(index).slip_m)
        moved_m, touching = contact.displacement_3d_m, contact.contact_pressure_pa > 0.0
        slipped_m = np.where(touching, slipped_m + slip_m, 0.0)
        now = replace(mesh, nodes=mesh.deformed(moved_m))
        area = float(now.areas[touching].sum()) or np.nan
        slipped = float(now.areas[slipped_m > _SLIPPED_M].sum()) / area
        truth = ShearTruth(mesh, moved_m, contact.nodal_force_n, now.normals)
        yield _Moved(name, _motion(pose, poses[-1]), truth, friction, slipped)


def _motion(pose: np.ndarray, last: np.ndarray) -> Motion | None:
    """Motion of the object since it was pressed in."""
    if pose[2, 3] > last[2, 3]:
        return None
    drag = pose[:3, 3] - last[:3, 3]
    drag[:2] = pose[:2, 3] - OFFSET_M
    return Motion(drag, float(np.arctan2(pose[1, 0], pose[0, 0])))


def _trials(frames: list[_Moved], sigma_px: float, grid: ShearGrid) -> Iterator[ShearTrial]:
    """Frames of one path, each warm-started from the previous one."""
    model = SensorModel.of(shear_sensor())
    both, alone = Pipeline(model), Pipeline(model)
    flows: list[FlowField] = []
    both.use_optical_flow(lambda frame: flows[frame.index])
    for pipeline, products in ((both, _SHEAR), (alone, _DEPTH)):
        pipeline.prepare(products)
    for k, (name, motion, truth, friction, slipped) in enumerate(frames):
        seen = sighting(model.camera, truth, DEPTH_NOISE, sigma_px, grid.seed + k)
        flows.append(seen.flow)
        frame = Frame(k, k / 30.0, seen.depth_m)
        begun = time.process_time()
        by_depth = alone.process(frame, _DEPTH)
        between = time.process_time()
        result = both.process(frame, _SHEAR)
        depth_ms, whole_ms = 1e3 * (between - begun), 1e3 * (time.process_time() - between)
        if motion is None:
            continue
        trial = judged(result, by_depth, truth, model.mesh, slipped)
        yield replace(
            trial,
            object_name=name,
            friction=friction,
            drag_m=float(np.linalg.norm(motion.drag_m)),
            twist_rad=motion.twist_rad,
            flow_sigma_px=sigma_px,
            torque_error=trial.torque_error if motion.twist_rad else np.nan,
            estimate_ms=depth_ms,
            traction_ms=max(0.0, whole_ms - depth_ms),
        )


def judged(
    result: Result, by_depth: Result, truth: ShearTruth, mesh: MembraneMesh, slipped: float
) -> ShearTrial:
    """Errors of a frame's traction and slip, and by depth alone; the caller fills the others."""
    (before, _), (estimate, patch) = by_depth.solution, result.solution
    alone, force, sigma = before.force_n, estimate.force_n, estimate.force_sigma_n
    if alone is None or force is None or sigma is None or result.traction is None:
        raise ValueError("the result lacks the force or the traction")
    true, size = truth.force_n, float(np.linalg.norm(truth.force_n))
    difference, length = force - true, float(np.linalg.norm(force))
    cosine = float(np.clip(force @ true / (length * size), -1.0, 1.0))
    center, seen = truth.center_m, by_depth.trusted_patch
    center_alone = np.full(3, np.nan) if seen is None else seen.center_of_pressure_m
    twisted = truth.torque_nm(center)[2]
    found = (patch.torque_nm + np.cross(patch.center_of_pressure_m - center, force))[2]
    slip = result.slip
    return ShearTrial(
        depth_status=before.status,
        status=result.traction.status,
        depth_force_error=float(np.linalg.norm(alone - true)) / size,
        force_error=float(np.linalg.norm(difference)) / size,
        angle_rad=float(np.arccos(cosine)),
        torque_error=abs(float(found / twisted) - 1.0),
        displacement_rms_m=along_error_m(estimate, truth, mesh),
        depth_center_error_m=float(np.linalg.norm(center_alone - center)),
        center_error_m=float(np.linalg.norm(patch.center_of_pressure_m - center)),
        sigmas=float(np.linalg.norm(difference) / np.linalg.norm(sigma)),
        slip=np.nan if slip is None else slip.share,
        true_slip=np.nan if slip is None else slipped,
    )


def along_error_m(estimate: Estimate, truth: ShearTruth, mesh: MembraneMesh) -> float:
    """Root mean square error of the displacement along the membrane over a mesh's nodes, m."""
    true = at_nodes(mesh, truth.mesh, truth.displacement_m)
    normals = at_nodes(mesh, truth.mesh, truth.normals)
    error = mesh.deformed(estimate.motion_m) - mesh.nodes - true
    along = error - np.einsum("ij,ij->i", error, normals)[:, None] * normals
    return float(np.sqrt(np.mean(np.sum(along**2, axis=1))))


TARGET_NOISE_PX = 0.03


def targets(trials: Sequence[ShearTrial]) -> list[Target]:
    """Whether the worst frames at the target's noise meet the targets."""
    some = [trial for trial in trials if trial.flow_sigma_px == TARGET_NOISE_PX]
    solved = [trial for trial in some if trial.status == "ok"]
    sticking = [t.slip > 0.0 for t in some if np.isfinite(t.slip) and np.isnan(t.friction)]
    worst = partial(over, solved, average=np.max)
    return [
        at_least("share of frames solved", len(solved) / max(1, len(some)), 1.0),
        at_most("force error, %", 100.0 * worst("force_error"), 3.0),
        at_most("force angle, °", np.degrees(worst("angle_rad")), 3.0),
        at_most("torque error, %", 100.0 * worst("torque_error"), 5.0),
        at_most("displacement, mm", 1e3 * worst("displacement_rms_m"), 0.05),
        at_most("centre, mm", 1e3 * worst("center_error_m"), 1.0),
        at_most(
            "false slip, share of frames", float(np.mean(sticking)) if sticking else np.nan, 0.05
        ),
        at_most("traction, ms of processor", over(solved, "traction_ms"), 15.0),
    ]


_COLUMNS = (
    Column("object", "object_name"),
    Column("μ", "friction", "g"),
    Column("drag mm", "drag_m", ".1f", 1e3),
    Column("twist °", "twist_rad", ".0f", float(np.degrees(1.0))),
    Column("flow px", "flow_sigma_px", "g"),
    *(Column(name, name) for name in ("depth_status", "status")),
    Column("depth alone %", "depth_force_error", ".0f", 100),
    Column("force %", "force_error", ".1f", 100),
    Column("angle °", "angle_rad", ".2f", float(np.degrees(1.0))),
    Column("torque %", "torque_error", ".1f", 100),
    Column("displ. mm", "displacement_rms_m", ".3f", 1e3),
    Column("depth's centre mm", "depth_center_error_m", ".1f", 1e3),
    Column("centre mm", "center_error_m", ".2f", 1e3),
    Column("slip %", "slip", ".0f", 100),
    Column("true %", "true_slip", ".0f", 100),
    Column("traction ms", "traction_ms", ".0f"),
)


def report_of(trials: Sequence[ShearTrial]) -> Report:
    """Every frame; no μ if everything sticks."""
    records = [asdict(trial) for trial in trials]
    return Report([Table("trials", records, _COLUMNS)], targets(trials))
