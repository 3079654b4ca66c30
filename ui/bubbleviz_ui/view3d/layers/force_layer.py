"""The contact force: an arrow that ends at the centre of pressure, its length the force."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front

TO_THE_FRONT = -4000.0
"""In front of the membrane: the tip may lie behind a dent."""


class ForceLayer(Layer):
    """Arrow along the resultant, drawn on the side it comes from."""

    name = "force"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        arrow = pv.Arrow(
            start=(-1, 0, 0), direction=(1, 0, 0), tip_length=0.3, tip_radius=0.07,
            shaft_radius=0.025,
        )  # fmt: skip
        self._longest_m = 0.05
        in_front(self.add(arrow, color=theme.FORCE, ambient=0.4), TO_THE_FRONT)
        self._has(False)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Scale to the size of the sensor: the end of the force scale is the dome's height."""
        self._longest_m = float(np.ptp(mesh.nodes[:, 2]))

    def draw(self, picture: Picture) -> None:
        """Place the arrow; nothing without contact."""
        patch = picture.result.trusted_patch
        force = float(np.linalg.norm(patch.force_n)) if patch is not None else 0.0
        touched = patch is not None and patch.area_m2 > 0 and force > 0
        if patch is not None and touched:
            length = self._longest_m * force / picture.ranges.force_n
            self.actor.user_matrix = _place(
                patch.force_n / force, patch.center_of_pressure_m, length
            )
        self._has(touched)


def _place(direction: np.ndarray, tip: np.ndarray, length: float) -> np.ndarray:
    """Matrix that puts the unit arrow's tip (its origin) at a point along a direction."""
    side = np.eye(3)[int(np.argmin(np.abs(direction)))]
    second = np.cross(direction, side)
    second /= np.linalg.norm(second)
    T = np.eye(4)
    T[:3, :3] = length * np.column_stack([direction, second, np.cross(direction, second)])
    T[:3, 3] = tip
    return T
