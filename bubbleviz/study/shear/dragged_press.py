"""Objects that are pressed in with friction, dragged and twisted: truths on a mesh of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.refine import refine
from bubbleviz.membrane.rubber_model.friction_forward import FrictionContact, FrictionForward
from bubbleviz.membrane.rubber_model.rubber_forward import RubberForward
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.simulation.press_path import press_path, touching_height
from bubbleviz.study.presses import made


@dataclass(frozen=True)
class DraggedPress:
    """One object pressed in on the axis or beside it, dragged along x, then twisted.

    Attributes
    ----------
    object_name : str
        Of a generator in `object_shapes`.
    depth_m : float
        Beyond first touch, along −z of B.
    drag_m, twist_rad : float
        As of `press_path`.
    friction : float
        Coulomb's μ.
    beside_m : (x, y)
        Of the object from the axis before it is dragged, m.
    """

    object_name: str
    depth_m: float
    drag_m: float = 0.0
    twist_rad: float = 0.0
    friction: float = 2.0
    beside_m: tuple[float, float] = (0.0, 0.0)

    def poses(self, mesh: MembraneMesh, frames: int) -> np.ndarray:
        """T_B_O (frames, 4, 4) against a membrane; InputError as of `press_path`."""
        obj, pose = made(self.object_name), np.eye(4)
        pose[:2, 3] = self.beside_m
        pose[2, 3] = touching_height(obj, pose, mesh) - self.depth_m
        return press_path(obj, pose, mesh, frames, self.drag_m, self.twist_rad)


@dataclass(frozen=True)
class DraggedTruth:
    """What is true of one frame.

    Attributes
    ----------
    T_B_O : (4, 4) array
    mesh : MembraneMesh
        At rest.
    contact : FrictionContact
        Its `slip_m` is since the frame before.
    slipped_m : (n,) array
        Way of each touching node over the object since it was touched, m; 0 for others.
    """

    T_B_O: np.ndarray
    mesh: MembraneMesh
    contact: FrictionContact
    slipped_m: np.ndarray

    @property
    def displacement_m(self) -> np.ndarray:
        """Of the nodes from rest, (n, 3), m."""
        return self.contact.displacement_3d_m

    @property
    def nodal_force_n(self) -> np.ndarray:
        """Of the object on the membrane, (n, 3), N."""
        return self.contact.nodal_force_n

    @property
    def pressed(self) -> MembraneMesh:
        """The membrane as it is."""
        return MembraneMesh(
            self.mesh.deformed(self.displacement_m), self.mesh.triangles, self.mesh.rim
        )

    @property
    def force_n(self) -> np.ndarray:
        """Resultant, (3,), N."""
        total: np.ndarray = self.nodal_force_n.sum(axis=0)
        return total

    @property
    def center_m(self) -> np.ndarray:
        """Centre of the normal force, (3,), m; NaN without contact."""
        pressed = self.pressed
        load = self.contact.contact_pressure_pa * pressed.areas
        if not load.any():
            return np.full(3, np.nan)
        center: np.ndarray = load @ pressed.nodes / load.sum()
        return center

    def torque_nm(self, about_m: np.ndarray) -> np.ndarray:
        """Torque about a point (3,), (3,), N·m."""
        arm = self.pressed.nodes - about_m
        total: np.ndarray = np.cross(arm, self.nodal_force_n).sum(axis=0)
        return total

    def slip_share(self, limit_m: float) -> float:
        """Share of the touching area that has slipped by more than a limit since it was touched.

        NaN without contact.
        """
        areas = np.where(self.contact.contact_pressure_pa > 0.0, self.pressed.areas, 0.0)
        if not areas.any():
            return float("nan")
        return float(areas[self.slipped_m > limit_m].sum() / areas.sum())


def dragged_truths(
    rubber_on: Callable[[MembraneMesh], RubberMembrane],
    gas_on: Callable[[MembraneMesh], Gas],
    mesh: MembraneMesh,
    press: DraggedPress,
    frames: int,
    levels: int = 1,
) -> Iterator[DraggedTruth]:
    """Frames of a press, one after the other, on a mesh cut finer where the object touches.

    Parameters
    ----------
    rubber_on, gas_on : function
        The membrane, and the gas behind it, on a mesh whose nodes are on the facets of `mesh`.
    mesh : MembraneMesh
        Before it is cut.
    press : DraggedPress
    frames : int
        10 or more; as of `press_path`.
    levels : int
        How often the triangles that touch are cut in four, with those beside them.

    Raises
    ------
    SolveError
        No equilibrium was found.
    """
    obj, poses = made(press.object_name), press.poses(mesh, frames)
    deepest = poses[np.argmin(poses[:, 2, 3])]
    for _ in range(levels):
        forward = RubberForward(rubber_on(mesh), gas_on(mesh))
        touching = forward.press(obj, deepest, quick=True).contact_pressure_pa > 0.0
        cut = touching[mesh.triangles].any(axis=1)
        beside = np.isin(np.arange(len(mesh.nodes)), mesh.triangles[cut])
        mesh = refine(mesh, beside[mesh.triangles].any(axis=1))
    model = FrictionForward(rubber_on(mesh), gas_on(mesh), press.friction)
    slipped = np.zeros(len(mesh.nodes))
    for pose, contact in zip(poses, model.follow(obj, poses), strict=False):
        if not contact.converged:
            raise SolveError(f"no equilibrium of {obj.name} with friction {press.friction:g}")
        slipped = np.where(contact.contact_pressure_pa > 0.0, slipped + contact.slip_m, 0.0)
        yield DraggedTruth(pose, model.mesh, contact, slipped)
