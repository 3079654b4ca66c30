"""How an object fits: residuals on contact points, correspondences, and what stays open."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.pose.observability import open_axes
from bubbleviz.result import Pose
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import cells, pairs
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front

COLOURS = [theme.NEARER, theme.BETWEEN, theme.GAP]
"""Inside the object, on it, outside."""

HIGHEST_M = 1e-3
TO_THE_FRONT = -4000.0
"""In front of the membrane, on which the points lie."""
ARROW = 0.4
"""Length of the arrows over the radius of the rim."""

_HEAD = 0.25  # length of an arrow's head over half the arrow's
_ARC = np.linspace(-2.4, 2.4, 33)  # rad, of an arrow that turns


class FitLayer(Layer):
    """Points, lines to the object, and arrows; their arrays are new with every pose."""

    name = "fit"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._length = 0.02
        self._points = pv.PolyData(np.zeros((1, 3)))
        self._points.point_data["distance"] = np.zeros(1)
        self._lines = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        self._arrows = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        self.points = self.add(
            self._points, scalars="distance", cmap=COLOURS, clim=(-HIGHEST_M, HIGHEST_M),
            point_size=5, show_scalar_bar=False, **canvas.view.quality.points,
        )  # fmt: skip
        self.lines = self.add(self._lines, color=theme.ORANGE, line_width=1, lighting=False)
        self.arrows = self.add(self._arrows, color=theme.NODE, line_width=3, lighting=False)
        for actor in self.actors:
            actor.SetPickable(False)
            in_front(actor, TO_THE_FRONT)
        self._has(False)

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Take the size of another sensor."""
        self._length = ARROW * float(np.hypot(*mesh.nodes[mesh.rim, :2].T).max())
        self._has(False)

    def draw(self, picture: Picture) -> None:
        """Draw the fit of a result; nothing where there is none."""
        pose = picture.result.pose
        if pose is not None:
            fitted = pose.status == "ok" and len(pose.points_m) > 0
            if fitted:
                self._fill(pose)
            self._has(fitted)

    def _fill(self, pose: Pose) -> None:
        count = len(pose.points_m)
        self._points.point_data.clear()
        self._points.points = pose.points_m
        self._points.verts = cells(np.arange(count)[:, None])
        self._points.point_data["distance"] = pose.distance_m
        self._points.GetPointData().SetActiveScalars("distance")
        self._lines.points = np.stack([pose.points_m, pose.places_m], axis=1).reshape(-1, 3)
        self._lines.lines = pairs(count)
        ends = open_arrows(pose, self._length)
        self._arrows.points = ends if len(ends) else np.repeat(pose.center_m[None], 2, axis=0)
        self._arrows.lines = pairs(max(len(ends) // 2, 1))


def open_arrows(pose: Pose, length_m: float) -> np.ndarray:
    """Ends (2 k, 3) in B of the pieces of arrows for the directions that are not determined.

    A shift is a straight arrow with two heads, a turn one around its axis.
    """
    shifts, turns = open_axes(pose.motions[:, ~pose.determined])
    pieces = [np.zeros((0, 3))]
    for axis in shifts:
        line = pose.center_m + length_m * np.array([[-1.0], [0.0], [1.0]]) * axis
        pieces.append(_arrow(line, _across(axis)))
    for axis in turns:
        side = _across(axis)
        around = np.cos(_ARC)[:, None] * side + np.sin(_ARC)[:, None] * np.cross(axis, side)
        pieces.append(_arrow(pose.center_m + 0.5 * length_m * around, axis))
    return np.concatenate(pieces)


def _across(axis: np.ndarray) -> np.ndarray:
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    return side / np.linalg.norm(side)


def _arrow(line: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Ends of the pieces of a polyline (p, 3) with a head at both ends, drawn to `side`."""
    pieces = [np.stack([line[:-1], line[1:]], axis=1).reshape(-1, 3)]
    size = _HEAD * float(np.linalg.norm(line[-1] - line[len(line) // 2]))
    for tip, before in ((line[-1], line[-2]), (line[0], line[1])):
        back = (before - tip) / np.linalg.norm(before - tip)
        for sign in (-1.0, 1.0):
            pieces.append(np.stack([tip, tip + size * (back + 0.5 * sign * side)]))
    return np.concatenate(pieces)
