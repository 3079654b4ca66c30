"""Objects that are pressed in with friction, dragged and twisted: ground truth on its own mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane import Gas, MembraneMesh, RubberForward, RubberMembrane, refinement
from bubbleviz.simulation import press_path, study_object, touching_height
from tests.oracles.stuck_press import ShearTruth


@dataclass(frozen=True)
class DraggedPress:
    """One object pressed in on the axis or at an offset, dragged along x, then twisted."""

    object_name: str  # for `study_object`
    depth_m: float  # beyond first touch, along −z of B
    # drag_m, twist_rad: as of `press_path`
    drag_m: float = 0.0
    twist_rad: float = 0.0
    friction: float = 2.0  # Coulomb's μ
    # (x, y), offset of the object from the axis before it is dragged, m
    offset_m: tuple[float, float] = (0.0, 0.0)

    def poses(self, mesh: MembraneMesh, frames: int) -> np.ndarray:
        """T_B_O (frames, 4, 4) against a membrane; InputError as of `press_path`."""
        obj, pose = study_object(self.object_name), np.eye(4)
        pose[:2, 3] = self.offset_m
        pose[2, 3] = touching_height(obj, pose, mesh) - self.depth_m
        return press_path(obj, pose, mesh, frames, self.drag_m, self.twist_rad)


@dataclass(frozen=True)
class DraggedTruth(ShearTruth):
    """Ground truth of one frame."""

    T_B_O: np.ndarray  # (4, 4)
    areas_m2: np.ndarray  # (n,), deformed areas of the touching nodes; 0 for others
    # (n,), slip distance of each touching node since first contact, m; 0 for others
    slipped_m: np.ndarray

    def slip_share(self, limit_m: float) -> float:
        """Share of the touching area that has slipped by more than a limit since first contact.

        NaN without contact.
        """
        if not self.areas_m2.any():
            return float("nan")
        return float(self.areas_m2[self.slipped_m > limit_m].sum() / self.areas_m2.sum())


def dragged_truths(
    # rubber_on, gas_on: the membrane, and the gas behind it, on a mesh whose nodes are on the
    # facets of `mesh`
    rubber_on: Callable[[MembraneMesh], RubberMembrane],
    gas_on: Callable[[MembraneMesh], Gas],
    mesh: MembraneMesh,  # before refinement
    press: DraggedPress,
    frames: int,  # 10 or more; as of `press_path`
    levels: int = 1,  # how often touching triangles and their neighbours are divided into four
) -> Iterator[DraggedTruth]:
    """Successive frames of a press, on a mesh refined at the contact.

    Raises
    ------
    SolveError
        No equilibrium was found.
    """
    obj, poses = study_object(press.object_name), press.poses(mesh, frames)
    deepest = poses[np.argmin(poses[:, 2, 3])]
    for _ in range(levels):
        forward = RubberForward(rubber_on(mesh), gas_on(mesh))
        touching = forward.press(obj, deepest, quick=True).contact_pressure_pa > 0.0
        cut = touching[mesh.triangles].any(axis=1)
        around = np.isin(np.arange(len(mesh.nodes)), mesh.triangles[cut])
        mesh = refinement(mesh, around[mesh.triangles].any(axis=1)).mesh
    model = RubberForward(rubber_on(mesh), gas_on(mesh))
    slipped = np.zeros(len(mesh.nodes))
    for pose, contact in zip(poses, model.follow(obj, poses, press.friction), strict=False):
        if not contact.converged:
            raise SolveError(f"no equilibrium of {obj.name} with friction {press.friction:g}")
        touching, moved = contact.contact_pressure_pa > 0.0, contact.displacement_3d_m
        slipped = np.where(touching, slipped + contact.slip_m, 0.0)
        now = replace(mesh, nodes=mesh.deformed(moved))
        areas = np.where(touching, now.areas, 0.0)
        force = contact.nodal_force_n
        yield DraggedTruth(mesh, moved, force, now.normals, pose, areas, slipped)
