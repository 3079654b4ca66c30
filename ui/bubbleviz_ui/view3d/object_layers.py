"""Layers of the registered object and of its fit."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane import MembraneMesh
from bubbleviz.pose import open_axes
from bubbleviz.result import Pose
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import lookup_table, rgb
from bubbleviz_ui.view3d.layer import Canvas, Layer, Segments, across, cells, draw_in_front

DETERMINED, UNDETERMINED, LOST = theme.GREEN, theme.AMBER, theme.GAP
OPACITY = 0.45  # so that the membrane shows behind it


class ObjectLayer(Layer):
    """The registered object, translucent, at its pose or initial pose."""

    name = "object"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._poly = pv.PolyData(np.zeros((3, 3)), np.array([3, 0, 1, 2]))
        self.add(self._poly, color=DETERMINED, opacity=OPACITY, ambient=0.3)
        self._obj: RigidObject | None = None
        # (4, 4) pose at which it is drawn; None while it is hidden
        self.T_B_O: np.ndarray | None = None
        self._set_drawn(False)

    def set_object(self, obj: RigidObject | None) -> None:
        """Set another object, or none; hidden until it has a pose."""
        if obj is self._obj:
            return
        self._obj = obj
        if obj is not None:
            self._poly.points = obj.vertices.astype(float)
            self._poly.faces = cells(obj.triangles)
        self.put(None)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Hide the object until it has a pose on the new sensor."""
        self.put(None)

    def show_pose(self, pose: Pose, stage: int, *, touched: bool) -> None:
        """Draw it at a stage of a pose, coloured by how well that is determined.

        Neutral where nothing touches.
        """
        known = DETERMINED if pose.determined.all() else UNDETERMINED
        first = pose.stage_one if stage == 1 else None
        T_B_O = pose.T_B_O if first is None else first.T_B_O
        missing = LOST if touched else theme.NEUTRAL
        self.put(T_B_O, known if pose.status == "ok" else missing)

    def put(self, T_B_O: np.ndarray | None, colour: str = DETERMINED) -> None:
        """Draw it at a pose (4, 4); None hides it."""
        self.T_B_O = T_B_O if T_B_O is not None and np.isfinite(T_B_O).all() else None
        if self.T_B_O is not None:
            self.actor.user_matrix = self.T_B_O
            self.actor.prop.color = colour
        self._set_drawn(self._obj is not None and self.T_B_O is not None)


# Fit of the object: distances of contact points, correspondences, undetermined directions.

COLOURS = [theme.NEARER, theme.BETWEEN, theme.GAP]
"""Contact points inside the object, on its surface, outside."""

HIGHEST_M = 1e-3
DEPTH_OFFSET = -4000.0
"""Draws the points in front of the membrane, on which they lie."""
ARROW = 0.4
"""Arrow length over the radius of the rim."""

_HEAD = 0.25  # length of an arrowhead over half the arrow length
_ARC = np.linspace(-2.4, 2.4, 33)  # rad, of a rotation arrow


class FitLayer(Layer):
    """Contact points, lines to the object, and arrows of undetermined directions."""

    name = "fit"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._length = 0.02
        self._points = pv.PolyData(np.zeros((1, 3)))
        self._points.point_data["distance"] = np.zeros(1)
        self.points = self.add(
            self._points,
            scalars="distance",
            table=lookup_table(np.array([(*rgb(colour), 255) for colour in COLOURS], np.uint8)),
            point_size=5,
            **canvas.view.quality.points,
        )
        self.points.mapper.scalar_range = (-HIGHEST_M, HIGHEST_M)
        draw_in_front(self.points, DEPTH_OFFSET)
        self.lines = Segments(self, theme.ORANGE, DEPTH_OFFSET, line_width=1)
        self.arrows = Segments(self, theme.NODE, DEPTH_OFFSET, line_width=3)
        self._set_drawn(False)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        self._length = ARROW * float(np.hypot(*mesh.nodes[mesh.rim, :2].T).max())
        self._set_drawn(False)

    def show_pose(self, pose: Pose | None) -> None:
        """Draw the fit of a pose; nothing without one."""
        fitted = pose is not None and pose.status == "ok" and len(pose.points_m) > 0
        if pose is not None and fitted:
            self._fill(pose)
        self._set_drawn(fitted)

    def _fill(self, pose: Pose) -> None:
        self._points.point_data.clear()
        self._points.points = pose.points_m
        self._points.verts = cells(np.arange(len(pose.points_m))[:, None])
        self._points.point_data["distance"] = pose.distance_m
        self._points.GetPointData().SetActiveScalars("distance")
        self.lines.draw(np.stack([pose.points_m, pose.places_m], axis=1))
        self.arrows.draw(undetermined_arrows(pose, self._length))


def undetermined_arrows(pose: Pose, length_m: float) -> np.ndarray:
    """Segments (k, 2, 3) in B of arrows along undetermined directions.

    A translation is a straight double arrow, a rotation an arc around its axis.
    """
    shifts, turns = open_axes(pose.motions[:, ~pose.determined])
    pieces = [np.zeros((0, 2, 3))]
    for axis in shifts:
        line = pose.center_m + length_m * np.array([[-1.0], [0.0], [1.0]]) * axis
        pieces.append(_arrow(line, across(axis)))
    for axis in turns:
        side = across(axis)
        around = np.cos(_ARC)[:, None] * side + np.sin(_ARC)[:, None] * np.cross(axis, side)
        pieces.append(_arrow(pose.center_m + 0.5 * length_m * around, axis))
    return np.concatenate(pieces)


def _arrow(line: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Segments of a double arrow along a polyline (p, 3), with barbs along `side`."""
    pieces = [np.stack([line[:-1], line[1:]], axis=1)]
    size = _HEAD * float(np.linalg.norm(line[-1] - line[len(line) // 2]))
    for tip, before in ((line[-1], line[-2]), (line[0], line[1])):
        back = (before - tip) / np.linalg.norm(before - tip)
        for sign in (-1.0, 1.0):
            pieces.append(np.array([[tip, tip + size * (back + 0.5 * sign * side)]]))
    return np.concatenate(pieces)
