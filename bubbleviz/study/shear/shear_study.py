"""Error of traction with friction on objects that are pressed in, dragged and twisted.

The truth is the exact membrane on a finer mesh: with the forces that hold it to an object that
sticks, or in contact by Coulomb's law, of which the estimator knows nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from bubbleviz.camera.triangle_scene import TriangleScene
from bubbleviz.colour.optical_flow import FlowField
from bubbleviz.frames.frame import Frame
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.reference_mesh import build_mesh, build_rubber
from bubbleviz.membrane.rubber_model.rubber_forward import RubberForward
from bubbleviz.pipeline import Pipeline, Product
from bubbleviz.result import Result, Traction
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation.depth_noise import DepthNoise
from bubbleviz.simulation.press_path import touching_height
from bubbleviz.study.presses import made
from bubbleviz.study.shear.dragged_press import DraggedPress, DraggedTruth, dragged_truths
from bubbleviz.study.shear.flow_sighting import sighting
from bubbleviz.study.shear.stuck_press import Motion, ShearTruth, StuckPress

_DEPTH: frozenset[Product] = frozenset({"patch"})
_SHEAR: frozenset[Product] = frozenset({"patch", "slip"})
_BESIDE_M = (0.005, -0.003)
"""Of the objects from the axis, m; chosen."""
DEPTH_NOISE = DepthNoise(absolute_m=5e-5, correlation_px=2.0)
_SLIPPED_M = 1e-4
"""Way over the object that a slip is told from; chosen: noise of the texture hides less."""
HEADING = np.array([0.894, 0.447, 0.0])
"""Way of the drags, off the mesh's axes; chosen."""


@dataclass(frozen=True)
class ShearGrid:
    """What is tried.

    Attributes
    ----------
    objects : tuple of (str, float)
        Generator in `object_shapes`, and depth in m.
    drags_m, twists_rad : tuple of float
        Ends of steps of one drag, and of one twist after it, begun anew for each object.
    frictions : tuple of float
        Coulomb's μ of presses that end in the last of the drags, and in the last of the twists.
    frames : int
        Of each of these, of which a quarter is the drag or twist.
    flow_sigmas_px : tuple of float
        Noise of the flow.
    slip_depths_m : tuple of float
        Of the balls of which a part of the contact slips.
    slip_seeds : int
        Noises of the exact flow of each.
    truth_nodes : int
    seed : int
    """

    objects: tuple[tuple[str, float], ...] = (("puck", 0.005), ("sphere", 0.006))
    drags_m: tuple[float, ...] = (0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025, 0.003, 0.0035, 0.004)
    twists_rad: tuple[float, ...] = tuple(np.radians((0.0, 4.0, 8.0, 12.0, 16.0, 20.0)).tolist())
    frictions: tuple[float, ...] = (1.0,)
    frames: int = 32
    flow_sigmas_px: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3)
    slip_depths_m: tuple[float, ...] = (0.0025, 0.004, 0.006, 0.010)
    slip_seeds: int = 3
    truth_nodes: int = 3_000
    seed: int = 7

    @property
    def paths(self) -> tuple[list[Motion], list[Motion]]:
        """One that drags and one that twists."""
        drags = [Motion(drag * HEADING) for drag in self.drags_m]
        return drags, [Motion(np.zeros(3), twist) for twist in self.twists_rad]

    @property
    def presses(self) -> int:
        """Number of paths, each with its truths."""
        return 2 * len(self.objects) * (1 + len(self.frictions))


def quick_shear_grid() -> ShearGrid:
    """A minute's worth."""
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
    """One frame of one path.

    Attributes
    ----------
    object_name : str
    friction : float
        Coulomb's μ; NaN where all that touched sticks.
    drag_m, twist_rad, flow_sigma_px : float
    depth_status, status : str
        Of the estimate by depth alone, and of the traction.
    depth_force_error, force_error : float
        Length of the difference of the force vectors over the true one's.
    angle_rad : float
        Between the forces.
    torque_error : float
        Of the torque's z about the true centre over the true one; NaN without a twist.
    displacement_rms_m : float
        Along the membrane, over the estimator's nodes.
    depth_center_error_m, center_error_m : float
        Of the centre of the contact's pressure, by depth alone and with friction; NaN where there
        is none.
    sigmas : float
        Length of the force's error over the length of its standard deviation.
    slip, true_slip : float
        Share of the patch that is said to have slipped, and that has by more than 0.1 mm; NaN
        where nothing is said.
    estimate_ms, traction_ms : float
        Processor time, ms.
    """

    object_name: str
    friction: float
    drag_m: float
    twist_rad: float
    flow_sigma_px: float
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
    estimate_ms: float
    traction_ms: float


def shear_sensor(nodes: int = 1_000) -> Sensor:
    """A dome of rubber with a camera like a RealSense D405 in it."""
    dome = Membrane(
        shape="spherical_cap", rim_radius_m=0.045, height_m=0.020, nodes=nodes, prestretch=1.2
    )
    camera = Camera(
        width=640,
        height=480,
        fx=430.0,
        fy=430.0,
        cx=319.5,
        cy=239.5,
        position_m=(0.0, 0.0, -0.060),
        noise_relative=6e-4,
    )
    pneumatics = Pneumatics(gauge_pressure_pa=6000.0, chamber_volume_m3=3e-4)
    return Sensor(name="shear dome", membrane=dome, pneumatics=pneumatics, camera=camera)


def run_shear(grid: ShearGrid, done: Callable[[int], None]) -> list[ShearTrial]:
    """Every frame of every path at every noise of the flow.

    Parameters
    ----------
    grid : ShearGrid
    done : callable
        Called with the number of paths that are done.
    """
    trials: list[ShearTrial] = []
    count = 0
    for name, depth_m in grid.objects:
        for frames in _presses(grid, name, depth_m):
            for sigma in grid.flow_sigmas_px:
                found = _trials(frames, sigma, grid.seed)
                trials += [replace(trial, object_name=name) for trial in found]
            count += 1
            done(count)
    return trials


class _Moved(NamedTuple):
    """A frame of a press, and how far its object was moved; None before it is pressed in."""

    motion: Motion | None
    truth: ShearTruth
    friction: float = np.nan


def _presses(grid: ShearGrid, name: str, depth_m: float) -> Iterator[list[_Moved]]:
    """Frames of every path of one object."""
    sensor = shear_sensor()
    press = pressed(sensor, name, depth_m, grid.truth_nodes)
    for path in grid.paths:
        yield list(map(_Moved, path, press.along(path)))
    mesh, tension = (
        build_mesh(sensor, grid.truth_nodes // 2),
        SensorModel.of(sensor).tension_n_per_m,
    )
    rubber_on = partial(build_rubber, sensor, tension_n_per_m=tension)
    gas_on = partial(Gas.of, sensor.pneumatics)
    for friction in grid.frictions:
        for drag_m, twist_rad in ((grid.drags_m[-1], 0.0), (0.0, grid.twists_rad[-1])):
            dragged = DraggedPress(name, depth_m, drag_m, twist_rad, friction, _BESIDE_M)
            truths = list(dragged_truths(rubber_on, gas_on, mesh, dragged, grid.frames, 0))
            yield [_Moved(_motion(truth, truths[-1]), truth, friction) for truth in truths]


def _motion(truth: DraggedTruth, last: DraggedTruth) -> Motion | None:
    """How far the object was moved since it was pressed in."""
    if truth.T_B_O[2, 3] > last.T_B_O[2, 3]:
        return None
    drag = truth.T_B_O[:3, 3] - last.T_B_O[:3, 3]
    drag[:2] = truth.T_B_O[:2, 3] - _BESIDE_M
    return Motion(drag, float(np.arctan2(truth.T_B_O[1, 0], truth.T_B_O[0, 0])))


def pressed(sensor: Sensor, name: str, depth_m: float, nodes: int) -> StuckPress:
    """An object that was pressed in beside the axis, on a mesh of so many nodes."""
    mesh = build_mesh(sensor, nodes)
    rubber = build_rubber(sensor, mesh, SensorModel.of(sensor).tension_n_per_m)
    gas = Gas.of(sensor.pneumatics, mesh)
    obj, T_B_O = made(name), np.eye(4)
    T_B_O[:2, 3] = _BESIDE_M
    T_B_O[2, 3] = touching_height(obj, T_B_O, mesh) - depth_m
    contact = RubberForward(rubber, gas).press(obj, T_B_O)
    touching = contact.contact_pressure_pa > 0.0
    return StuckPress(rubber, gas, contact.displacement_3d_m, touching)


def _trials(frames: list[_Moved], sigma_px: float, seed: int) -> Iterator[ShearTrial]:
    """Frames of one path, each begun where the one before ended."""
    model = SensorModel.of(shear_sensor())
    both, alone = Pipeline(model), Pipeline(model)
    flows: list[FlowField] = []
    both.watch_texture(lambda frame: flows[frame.index])
    for pipeline, products in ((both, _SHEAR), (alone, _DEPTH)):
        pipeline.prepare(products)
    for k, (motion, truth, friction) in enumerate(frames):
        seen = sighting(model.camera, truth, DEPTH_NOISE, sigma_px, seed + k)
        flows.append(seen.flow)
        frame = Frame(k, k / 30.0, seen.depth_m)
        begun = time.process_time()
        alone.process(frame, _DEPTH)
        between = time.process_time()
        result = both.process(frame, _SHEAR)
        depth_ms, whole_ms = 1e3 * (between - begun), 1e3 * (time.process_time() - between)
        if motion is None:
            continue
        trial = judged(result, truth, model.mesh)
        yield replace(
            trial,
            friction=friction,
            drag_m=float(np.linalg.norm(motion.drag_m)),
            twist_rad=motion.twist_rad,
            flow_sigma_px=sigma_px,
            torque_error=trial.torque_error if motion.twist_rad else np.nan,
            estimate_ms=depth_ms,
            traction_ms=max(0.0, whole_ms - depth_ms),
        )


def judged(result: Result, truth: ShearTruth, mesh: MembraneMesh) -> ShearTrial:
    """Errors of a frame's traction and slip; what is not of the result is left open."""
    estimate, traction = result.estimate, result.traction
    if estimate is None or traction is None:
        raise ValueError("the result lacks the estimate or the traction")
    alone = np.full(3, np.nan) if estimate.force_n is None else estimate.force_n
    true, size = truth.force_n, float(np.linalg.norm(truth.force_n))
    difference = traction.force_n - true
    length = float(np.linalg.norm(traction.force_n))
    cosine = float(np.clip(traction.force_n @ true / (length * size), -1.0, 1.0))
    center, patch = truth.center_m, result.trusted_patch
    center_alone = np.full(3, np.nan) if patch is None else patch.center_of_pressure_m
    twisted = truth.torque_nm(center)[2]
    found = traction.torque_about(center)[2]
    slip, true_slip = result.slip, 0.0
    if slip is not None and isinstance(truth, DraggedTruth):
        true_slip = truth.slip_share(_SLIPPED_M)
    return ShearTrial(
        object_name="",
        friction=np.nan,
        drag_m=np.nan,
        twist_rad=np.nan,
        flow_sigma_px=np.nan,
        depth_status=estimate.status,
        status=traction.status,
        depth_force_error=float(np.linalg.norm(alone - true)) / size,
        force_error=float(np.linalg.norm(difference)) / size,
        angle_rad=float(np.arccos(cosine)),
        torque_error=abs(float(found / twisted) - 1.0),
        displacement_rms_m=along_error_m(traction, truth, mesh),
        depth_center_error_m=float(np.linalg.norm(center_alone - center)),
        center_error_m=float(np.linalg.norm(traction.center_m - center)),
        sigmas=float(np.linalg.norm(difference) / np.linalg.norm(traction.force_sigma_n)),
        slip=np.nan if slip is None else slip.share,
        true_slip=np.nan if slip is None else true_slip,
        estimate_ms=np.nan,
        traction_ms=np.nan,
    )


def along_error_m(traction: Traction, truth: ShearTruth, mesh: MembraneMesh) -> float:
    """Root mean square error of the displacement along the membrane over a mesh's nodes, m."""
    found = TriangleScene(truth.mesh.nodes, truth.mesh.triangles).closest(mesh.nodes)
    corners = truth.mesh.triangles[found.triangle]
    true = np.einsum("ij,ijk->ik", found.barycentric, truth.displacement_m[corners])
    normals = np.einsum("ij,ijk->ik", found.barycentric, truth.normals[corners])
    error = traction.positions_m - mesh.nodes - true
    along = error - np.einsum("ij,ij->i", error, normals)[:, None] * normals
    return float(np.sqrt(np.mean(np.sum(along**2, axis=1))))
