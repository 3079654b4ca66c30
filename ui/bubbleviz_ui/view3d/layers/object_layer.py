"""The object that is looked for, translucent, at its pose or where it is to begin."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Pose
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import cells
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture

FOUND, UNDETERMINED, LOST = theme.GREEN, theme.AMBER, theme.GAP
OPACITY = 0.45  # so that the membrane shows behind it


class ObjectLayer(Layer):
    """One actor; its mesh changes with the object, its matrix with the pose.

    Attributes
    ----------
    place : (4, 4) array or None
        Where it is drawn now; None while it is not.
    """

    name = "object"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._poly = pv.PolyData(np.zeros((3, 3)), np.array([3, 0, 1, 2]))
        self.add(self._poly, color=FOUND, opacity=OPACITY, ambient=0.3).SetPickable(False)
        self._has_mesh = False
        self.place: np.ndarray | None = None
        self._has(False)

    def set_object(self, obj: RigidObject | None) -> None:
        """Take another object, or none; it is not drawn before it has a place."""
        self._has_mesh = obj is not None
        if obj is not None:
            self._poly.points = obj.vertices.astype(float)
            self._poly.faces = cells(obj.triangles)
        self.put(None)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Forget where it was on another sensor."""
        self.put(None)

    def draw(self, picture: Picture) -> None:
        """Draw the pose of a result; what it has none of stays where it was."""
        pose = picture.result.pose
        if pose is not None:
            self.put_pose(pose, picture.choices.pose_stage)

    def put_pose(self, pose: Pose, stage: int) -> None:
        """Place it at a stage of a pose, in the colour of how well it is known."""
        known = FOUND if pose.determined.all() else UNDETERMINED
        self.put(shown_place(pose, stage), known if pose.status == "ok" else LOST)

    def put(self, T_B_O: np.ndarray | None, colour: str = FOUND) -> None:
        """Place it at a pose (4, 4), or nowhere."""
        self.place = T_B_O if T_B_O is not None and np.isfinite(T_B_O).all() else None
        if self.place is not None:
            self.actor.user_matrix = self.place
            self.actor.prop.color = colour
        self._has(self._has_mesh and self.place is not None)


def shown_place(pose: Pose, stage: int) -> np.ndarray:
    """T_B_O (4, 4) of the stage that is to be seen."""
    if stage == 1 and pose.stage_one is not None:
        return pose.stage_one.T_B_O
    return pose.T_B_O
