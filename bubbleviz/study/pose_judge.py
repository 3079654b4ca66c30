"""Error of a pose over the directions that the true contact determines, modulo symmetry.

A direction is determined when the normals of the true contact, at the true pose and with the
sensor's own noise, fix it to 0.4 mm at the patch's edge (`bubbleviz.pose.uncertainty`). No estimate
has a part in that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.frames.synthetic import Truth
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.pose.model import ObjectModel
from bubbleviz.pose.motion import motion_between, rows
from bubbleviz.pose.registration import Precision
from bubbleviz.pose.symmetry import symmetries
from bubbleviz.pose.uncertainty import LEAST_RADIUS_M, Directions, directions

SUCCESS_M, SUCCESS_RAD = 3e-3, np.radians(5.0)

_PARALLEL = np.cos(np.radians(45.0))


@dataclass(frozen=True)
class PoseErrors:
    """How far a pose is from the true one, in motion of the patch.

    Attributes
    ----------
    error_m, error_rad : float
        Over the determined directions.
    whole_m, whole_rad : float
        Over all six.
    """

    error_m: float
    error_rad: float
    whole_m: float
    whole_rad: float

    @property
    def success(self) -> bool:
        """Within 3 mm and 5° over the determined directions."""
        return bool(self.error_m <= SUCCESS_M and self.error_rad <= SUCCESS_RAD)


class PoseJudge:
    """Judges poses of one object.

    Parameters
    ----------
    model : ObjectModel
    mesh : MembraneMesh
        Of the truths.
    precision : Precision
        Of the sensor, at its own noise.
    """

    def __init__(self, model: ObjectModel, mesh: MembraneMesh, precision: Precision) -> None:
        self._model, self._mesh, self._precision = model, mesh, precision
        self._symmetries = symmetries(model)

    def contact(self, truth: Truth, T_B_O: np.ndarray) -> tuple[np.ndarray, float, Directions]:
        """Centre (3,) and radius in m of the true patch, and what its normals determine."""
        touching = np.flatnonzero(truth.contact_pressure_pa > 0.0)
        points = self._mesh.deformed(truth.displacement_m)[touching]
        areas = self._mesh.areas[touching]
        center = areas @ points / areas.sum()
        radius = float(np.sqrt(areas @ np.sum((points - center) ** 2, axis=1) / areas.sum()))
        R = T_B_O[:3, :3]
        normals = self._model.closest((points - T_B_O[:3, 3]) @ R).normal @ R.T
        facing = np.einsum("ij,ij->i", normals, self._mesh.normals[touching]) < -_PARALLEL
        J = rows(normals[facing], points[facing], center)
        surface = (J.T * (self._precision.per_area * areas[facing])) @ J
        return center, radius, directions(surface, radius)

    def errors(self, T_B_O: np.ndarray, truth: Truth, true_pose: np.ndarray) -> PoseErrors:
        """Errors of a pose (4, 4); those of the symmetric pose that is closest."""
        center, radius, found = self.contact(truth, true_pose)
        alike = [motion_between(true_pose, T_B_O @ same, center) for same in self._symmetries]
        radius = max(radius, LEAST_RADIUS_M)
        arm = np.array([1.0, 1.0, 1.0, radius, radius, radius])
        basis = (arm[:, None] * found.motions)[:, found.determined]
        scaled = np.array(alike) * arm
        known = scaled @ basis @ basis.T
        best = int(np.argmin(np.linalg.norm(known, axis=1) + 1e-6 * np.linalg.norm(scaled, axis=1)))
        return PoseErrors(
            error_m=float(np.linalg.norm(known[best, :3])),
            error_rad=float(np.linalg.norm(known[best, 3:]) / radius),
            whole_m=float(np.linalg.norm(scaled[best, :3])),
            whole_rad=float(np.linalg.norm(scaled[best, 3:]) / radius),
        )
