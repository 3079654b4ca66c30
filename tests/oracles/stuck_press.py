"""A membrane that sticks to a rigid object, which is dragged and twisted after it was pressed in.

Nodes in contact after frictionless pressing move with the object, all others are in equilibrium of
the exact membrane; the reactions of the moved nodes are the contact force. Nodes with a tensile
reaction are released.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from bubbleviz.errors import SolveError
from bubbleviz.membrane import (
    Gas,
    MembraneMesh,
    RubberForward,
    RubberMembrane,
    build_mesh,
    build_rubber,
    symmetric_lu,
)
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import study_object, touching_height

OFFSET_M = (0.005, -0.003)  # of the objects from the axis, m; chosen
_MAX_STEP_M = 5e-4  # of the object's motion at its patch's edge
_TOLERANCE = 1e-8  # residual force at a node relative to the largest load


@dataclass(frozen=True)
class ShearTruth:
    """Equilibrium of a membrane with an object that sticks to it, or slips over it."""

    mesh: MembraneMesh  # at rest
    displacement_m: np.ndarray  # (n, 3)
    nodal_force_n: np.ndarray  # (n, 3), of the object on the membrane; 0 where it does not touch
    normals: np.ndarray  # (n, 3), current unit normals, outward

    @property
    def force_n(self) -> np.ndarray:
        """Resultant, (3,), N."""
        total: np.ndarray = self.nodal_force_n.sum(axis=0)
        return total

    def torque_nm(self, about_m: np.ndarray) -> np.ndarray:
        """Torque about a point (3,), N·m."""
        arm = self.mesh.nodes + self.displacement_m - about_m
        total: np.ndarray = np.cross(arm, self.nodal_force_n).sum(axis=0)
        return total

    @property
    def center_m(self) -> np.ndarray:
        """Centre of the contact's pressure, (3,), m; NaN without contact."""
        normal = -np.einsum("ij,ij->i", self.nodal_force_n, self.normals)
        if not normal.any():
            return np.full(3, np.nan)
        center: np.ndarray = normal @ (self.mesh.nodes + self.displacement_m) / normal.sum()
        return center


@dataclass(frozen=True)
class Motion:
    """Motion of an object since it was pressed in."""

    drag_m: np.ndarray  # (3,)
    twist_rad: float = 0.0  # about z through the centre of its contact
    # (n,), share of the motion that nodes do not follow because they slip; None: 0
    lost: np.ndarray | None = None


class StuckPress:
    """An object that a membrane sticks to.

    Attributes
    ----------
    touching : (n,) bool array
    pressed_m : (n, 3) array
        Nodes before the object is moved, m.
    """

    def __init__(
        self,
        rubber: RubberMembrane,
        gas: Gas,  # behind the membrane at rest
        displacement_m: np.ndarray,  # (n, 3), of an equilibrium with the object
        touching: np.ndarray,  # (n,) bool, nodes that touch it
    ) -> None:
        self._rubber, self._gas, self.touching = rubber, gas, touching
        self.pressed_m = rubber.mesh.nodes + displacement_m
        self._rest_volume = rubber.volume(rubber.mesh.nodes)

    def along(self, path: Iterable[Motion]) -> Iterator[ShearTruth]:
        """Equilibria along a path of the object, each starting from the previous one.

        Raises
        ------
        SolveError
            No equilibrium was found.
        """
        stuck, x, before = self.touching.copy(), self.pressed_m, self.pressed_m
        for motion in path:
            goal = self._goal(motion)
            way = float(np.linalg.norm(goal - before, axis=1)[self.touching].max())
            steps = max(1, int(np.ceil(way / _MAX_STEP_M)))
            for step in range(1, steps + 1):
                aim = before + step / steps * (goal - before)
                x, stuck = self._holding(x, stuck, aim)
            before = goal
            yield self._truth(x, stuck)

    def moved(self, motion: Motion) -> ShearTruth:
        """Equilibrium at the end of one motion; SolveError if none was found."""
        return next(self.along([motion]))

    def _goal(self, motion: Motion) -> np.ndarray:
        """Positions of the sticking nodes, (n, 3), m."""
        center = self.pressed_m[self.touching].mean(axis=0)
        turn = Rotation.from_rotvec([0.0, 0.0, motion.twist_rad]).as_matrix()
        carried = (self.pressed_m - center) @ turn.T + center + np.asarray(motion.drag_m)
        lost = np.zeros(len(carried)) if motion.lost is None else motion.lost
        goal: np.ndarray = carried + lost[:, None] * (self.pressed_m - carried)
        return goal

    def _holding(
        self, x: np.ndarray, stuck: np.ndarray, aim: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Equilibrium with the sticking nodes fixed, and those of them under compression."""
        while True:
            x = self._balanced(np.where(stuck[:, None], aim, x), stuck)
            outward = np.einsum("ij,ij->i", self._force(x), self._normals(x))
            if not (pulled := stuck & (outward > 0.0)).any():
                return x, stuck
            stuck = stuck & ~pulled

    def _truth(self, x: np.ndarray, stuck: np.ndarray) -> ShearTruth:
        force = np.where(stuck[:, None], self._force(x), 0.0)
        moved = x - self._rubber.mesh.nodes
        return ShearTruth(self._rubber.mesh, moved, force, self._normals(x))

    def _balanced(self, x: np.ndarray, stuck: np.ndarray) -> np.ndarray:
        """Equilibrium of the free nodes, from a nearby state."""
        moving = self._rubber.moving
        free = ~stuck[moving]
        rows = np.flatnonzero(np.repeat(free, 3))
        load = self._rubber.gauge_pressure_pa * float(self._rubber.mesh.areas.max())
        for _ in range(30):
            left = self._force(x)[moving][free].ravel()
            if np.abs(left).max() < _TOLERANCE * load:
                return x
            change, stiffness = self._gas_at(x)
            inside = self._rubber.gauge_pressure_pa + change
            K = self._rubber.tangent(x, inside)
            a = self._rubber.volume_gradient(x)[moving][free].ravel()
            factor = symmetric_lu(sparse.csc_array(K[rows][:, rows]))
            plain, by_gas = factor.solve(left), factor.solve(a)
            plain -= stiffness * (a @ plain) / (1.0 + stiffness * (a @ by_gas)) * by_gas
            motion = np.zeros((len(moving), 3))
            motion[free] = -plain.reshape(-1, 3)
            longest = float(np.abs(motion).max())
            x = x.copy()
            x[moving] += min(1.0, 1e-3 / longest) * motion
        raise SolveError("no equilibrium of the membrane that sticks to the object")

    def _gas_at(self, x: np.ndarray) -> tuple[float, float]:
        volume = self._gas.V0 + self._rubber.volume(x) - self._rest_volume
        pressure = self._gas.P0 * self._gas.V0 / volume
        return pressure - self._gas.P0, pressure / volume

    def _force(self, x: np.ndarray) -> np.ndarray:
        """External force on the nodes for equilibrium, (n, 3), N."""
        force = self._rubber.residual(x, self._rubber.gauge_pressure_pa + self._gas_at(x)[0])
        force[self._rubber.mesh.rim] = 0.0
        return force

    def _normals(self, x: np.ndarray) -> np.ndarray:
        return MembraneMesh(x, self._rubber.mesh.triangles, self._rubber.mesh.rim).normals


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


def pressed(sensor: Sensor, name: str, depth_m: float, nodes: int) -> StuckPress:
    """An object pressed in at an offset from the axis, on a mesh of about `nodes` nodes."""
    mesh = build_mesh(sensor, nodes)
    rubber = build_rubber(sensor, mesh, SensorModel.of(sensor).tension_n_per_m)
    gas = Gas.of(sensor.pneumatics, mesh)
    obj, T_B_O = study_object(name), np.eye(4)
    T_B_O[:2, 3] = OFFSET_M
    T_B_O[2, 3] = touching_height(obj, T_B_O, mesh) - depth_m
    contact = RubberForward(rubber, gas).press(obj, T_B_O)
    touching = contact.contact_pressure_pa > 0.0
    return StuckPress(rubber, gas, contact.displacement_3d_m, touching)
