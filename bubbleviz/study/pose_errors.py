"""Error of a pose over the directions that the true contact determines, modulo symmetry.

A direction is determined when the normals of the true contact, at the true pose and with the
sensor's own noise, fix it to 0.4 mm at the patch's edge (`bubbleviz.pose.observability`). No
estimate has a part in that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.pose.object_model import ObjectModel
from bubbleviz.pose.observability import LEAST_RADIUS_M, Directions, directions
from bubbleviz.pose.registration import Precision
from bubbleviz.pose.rigid_motion import motion_between, rows
from bubbleviz.pose.symmetry import symmetries

SUCCESS_M, SUCCESS_RAD = 3e-3, np.radians(5.0)  # what a grasp bears; chosen

_PARALLEL = np.cos(np.radians(45.0))  # faces that look at the membrane


@dataclass(frozen=True)
class PoseErrors:
    """How far a pose is from the true one, in motion of the patch."""

    error_m: float  # over the determined directions
    error_rad: float
    whole_m: float  # over all six
    whole_rad: float

    @property
    def success(self) -> bool:
        """Within 3 mm and 5° over the determined directions."""
        return bool(self.error_m <= SUCCESS_M and self.error_rad <= SUCCESS_RAD)


@dataclass(frozen=True)
class TrueContact:
    """What truly touches, and which motions of the object that determines."""

    T_B_O: np.ndarray  # (4, 4)
    center: np.ndarray  # (3,), of the true patch
    radius_m: float
    directions: Directions


class PoseJudge:
    """Judges poses of one object, by the precision of the sensor at its own noise."""

    def __init__(self, model: ObjectModel, precision: Precision) -> None:
        self._model, self._precision = model, precision
        self._symmetries = symmetries(model)

    def touching(
        self, mesh: MembraneMesh, displacement_m: np.ndarray, pressure_pa: np.ndarray, T: np.ndarray
    ) -> TrueContact:
        """The contact of a membrane moved by (n, 3) under pressures (n,), object at T (4, 4)."""
        touching = np.flatnonzero(pressure_pa > 0.0)
        points = mesh.deformed(displacement_m)[touching]
        areas = mesh.areas[touching]
        center = areas @ points / areas.sum()
        radius = float(np.sqrt(areas @ np.sum((points - center) ** 2, axis=1) / areas.sum()))
        normals = self._model.closest((points - T[:3, 3]) @ T[:3, :3]).normal @ T[:3, :3].T
        facing = np.einsum("ij,ij->i", normals, mesh.normals[touching]) < -_PARALLEL
        J = rows(normals[facing], points[facing], center)
        surface = (J.T * (self._precision.per_area * areas[facing])) @ J
        return TrueContact(T, center, max(radius, LEAST_RADIUS_M), directions(surface, radius))

    def errors(self, T_B_O: np.ndarray, true: TrueContact) -> PoseErrors:
        """Errors of a pose (4, 4); those of the symmetric pose that is closest."""
        alike = [motion_between(true.T_B_O, T_B_O @ S, true.center) for S in self._symmetries]
        arm = np.array([1.0, 1.0, 1.0, *3 * [true.radius_m]])
        found = true.directions
        basis = (arm[:, None] * found.motions)[:, found.determined]
        scaled = np.array(alike) * arm
        known = scaled @ basis @ basis.T
        # Symmetric poses are alike in the determined directions: the closest of them in all others.
        best = int(np.argmin(np.linalg.norm(known, axis=1) + 0.05 * np.linalg.norm(scaled, axis=1)))
        return PoseErrors(
            error_m=float(np.linalg.norm(known[best, :3])),
            error_rad=float(np.linalg.norm(known[best, 3:]) / true.radius_m),
            whole_m=float(np.linalg.norm(scaled[best, :3])),
            whole_rad=float(np.linalg.norm(scaled[best, 3:]) / true.radius_m),
        )
