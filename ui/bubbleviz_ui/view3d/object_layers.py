"""The object that is looked for, translucent, at its pose or where it is to begin."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from bubbleviz.diagnostics import Probed
from bubbleviz.membrane import MembraneMesh
from bubbleviz.pose import open_axes
from bubbleviz.result import Pose
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import Sensor
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb
from bubbleviz_ui.view3d.layer import Canvas, Layer, Picture, add_mark, cells, in_front, pairs
from bubbleviz_ui.view3d.render_view import View

FOUND, UNDETERMINED, LOST = theme.GREEN, theme.AMBER, theme.GAP
OPACITY = 0.45  # so that the membrane shows behind it


class ObjectLayer(Layer):
    """One actor; its mesh changes with the object, its matrix with the pose."""

    name = "object"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._poly = pv.PolyData(np.zeros((3, 3)), np.array([3, 0, 1, 2]))
        self.add(self._poly, color=FOUND, opacity=OPACITY, ambient=0.3).SetPickable(False)
        self._has_mesh = False
        # (4, 4) array or None: Where it is drawn now; None while it is not
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
            self.put_pose(pose, picture.settings.pose_stage)

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


# How an object fits: residuals on contact points, correspondences, and what stays open.


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


# The place under the mouse: its measured point, its node, and the camera's ray to it.


class ProbeMarks:
    """Two dots and a line, in front of everything; hidden while nothing is pointed at."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._camera_m = np.zeros(3)
        self._dots = pv.PolyData(np.zeros((2, 3)))
        self._dots.point_data["colour"] = np.array([rgb(theme.LINE), rgb(theme.NODE)], np.uint8)
        self._ray = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        dots = {"scalars": "colour", "rgb": True, "point_size": 11, **view.quality.points}
        self.actors = [
            add_mark(view, self._ray, color=theme.LINE, line_width=1, opacity=0.6, lighting=False),
            add_mark(view, self._dots, **dots),
        ]
        view.follow_theme(self._paint)
        self.show(None)

    def _paint(self, colours: theme.Colours) -> None:
        """Take the colour of text for what was measured: it lies off the membrane, too."""
        self._dots.point_data["colour"][0] = rgb(colours.text)
        self._dots.Modified()
        self.actors[0].prop.color = colours.text

    def set_camera(self, position_m: np.ndarray) -> None:
        """Take where the depth camera is, (3,) in B."""
        self._camera_m = np.asarray(position_m, float)

    def show(self, place: Probed | None, drawn_m: np.ndarray | None = None) -> None:
        """Light up a place, or nothing; its node at `drawn_m` (3,), where that is elsewhere."""
        measured = place is not None and bool(np.isfinite(place.point_m).all())
        if place is not None:
            node = place.node_m if drawn_m is None else drawn_m
            point = place.point_m if measured else node
            self._dots.points[:] = np.array([point, node])
            self._ray.points[:] = np.array([self._camera_m, point])
            self._dots.Modified()
            self._ray.Modified()
        for actor in self.actors:
            actor.visibility = place is not None
        self._view.refresh()
