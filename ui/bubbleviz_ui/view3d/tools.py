"""Tools of the 3-D view: callouts, picking, section, turntable, pictures, viewpoints."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np
import pyvista as pv
from numpy.typing import ArrayLike
from PySide6.QtCore import Qt, QTimer
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkFiltersCore import vtkCutter
from vtkmodules.vtkRenderingCore import vtkCellPicker, vtkTextActor, vtkWindowToImageFilter

from bubbleviz.camera import DepthCamera
from bubbleviz.diagnostics import Probed
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import DASH, Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import rgb
from bubbleviz_ui.view3d.layer import Layer, Surface, add_mark
from bubbleviz_ui.view3d.render_view import POINTS_PER_INCH, View
from bubbleviz_ui.view3d.text import left_of_bars, set_text_style

DOT, TEXT = 11, 13  # px, size of a dot and of the numbers at it


class Callout:
    """Two dots and a line in front of everything, with numbers: of a probed place or a distance."""

    def __init__(self, view: View, units: Units) -> None:
        self._view, self._units = view, units
        self._dots = pv.PolyData(np.zeros((2, 3)))
        self._dots.point_data["colour"] = np.zeros((2, 3), np.uint8)
        self._ends = pv.PolyData(np.zeros((2, 3)), lines=[2, 0, 1])
        dots = {"scalars": "colour", "point_size": DOT, **view.quality.points}
        self._line = add_mark(view, self._ends, lighting=False)
        self._text = vtkTextActor()
        self._text.GetPositionCoordinate().SetCoordinateSystemToWorld()
        set_text_style(view, self._text.GetTextProperty(), TEXT, ground="field")
        view.renderer.AddViewProp(self._text)
        self._marks = [self._line, add_mark(view, self._dots, **dots)]
        self.actors = [*self._marks, self._text]
        # Shows the same again, in the current units and theme
        self.write: Callable[[], None] = self.hide
        view.follow_theme(lambda _: self.write())

    def hide(self) -> None:
        self.write = self.hide
        for actor in self.actors:
            actor.SetVisibility(False)
        self._view.refresh()

    def show_place(
        self,
        place: Probed,
        drawn_m: np.ndarray,  # (3,) in B: exaggerated position on the membrane
        camera_m: np.ndarray,  # (3,) in B: start of the ray through the measured point
        *,
        marked: bool = True,  # With dots and ray
    ) -> None:
        """Show the numbers of a probed place; mark its measured point and that of the membrane."""
        self.write = partial(self.show_place, place, drawn_m, camera_m, marked=marked)
        measured = place.point_m if np.isfinite(place.point_m).all() else drawn_m
        colour = theme.of(self._view).text  # as it may lie off the membrane
        self._dots.point_data["colour"][:] = rgb(colour), rgb(theme.NODE)
        self._line.prop = pv.Property(color=colour, line_width=1, opacity=0.6, lighting=False)
        self._draw((measured, drawn_m), (camera_m, measured), drawn_m, marked=marked)
        self._text.SetInput(probe_text(place, self._units))

    def show_distance(self, ends_m: Sequence[np.ndarray]) -> None:
        """Show one or two points (3,) in B; between two a line with its length."""
        self.write = partial(self.show_distance, ends_m)
        self._dots.point_data["colour"][:] = rgb(theme.GREEN)
        self._line.prop = pv.Property(color=theme.GREEN, line_width=2, lighting=False)
        ends = ends_m[0], ends_m[-1]
        self._draw(ends, ends, np.mean(ends, axis=0), marked=True)
        length_m = float(np.linalg.norm(ends[1] - ends[0]))
        self._text.SetInput(f" {self._units.length.text(length_m)} ")
        self._text.SetVisibility(len(ends_m) == 2)

    def _draw(
        self,
        dots: Sequence[np.ndarray],
        ends: Sequence[np.ndarray],
        at_m: np.ndarray,  # Of the text
        *,
        marked: bool,
    ) -> None:
        self._dots.points[:], self._ends.points[:] = dots, ends
        self._dots.Modified()
        self._ends.Modified()
        for mark in self._marks:
            mark.SetVisibility(marked)
        self._text.SetVisibility(True)
        self._text.GetPositionCoordinate().SetValue(*at_m)
        at, style = self._view.screen_position(at_m), self._text.GetTextProperty()
        # towards the middle of the view
        right = at.x() > self._view.width() / 2
        style.SetJustificationToRight() if right else style.SetJustificationToLeft()
        low = at.y() > self._view.height() / 2
        up, down = style.SetVerticalJustificationToBottom, style.SetVerticalJustificationToTop
        up() if low else down()
        self._view.refresh()


def patch_text(place: Probed) -> str:
    """Whether a place is in the patch; a dash without a trusted one."""
    return {True: "in the patch", False: "outside the patch", None: DASH}[place.in_patch]


def probe_text(place: Probed, units: Units) -> str:
    """Lines about a probed place; the residual only if known."""
    lines = [
        f"p_c {units.pressure.text(place.pressure_pa)}",
        f"u {units.length.text(place.displacement_m)}",
        f"residual {units.fine_length.text(place.residual_m)}",
        f"node {place.node}",
        patch_text(place),
    ]
    if math.isnan(place.residual_m):
        del lines[2]
    return "\n".join(f" {line} " for line in lines)


# Picking of points in the 3-D view.

PICK_RADIUS = 0.004
"""Largest distance from a measured point, as a share of the view's diagonal."""


class Picker:
    """Picks a point on a surface, or else a point of a cloud.

    Hidden and clipped parts are not picked.
    """

    def __init__(self, view: View, surface: Surface, layers: Mapping[str, Layer]) -> None:
        self._view, self._surface = view, surface
        self._membrane, self._cloud = layers["membrane"].actor, layers["cloud"].actor
        self._surface_picker = vtkCellPicker()
        self._surface_picker.SetTolerance(0.0)
        self._surface_picker.PickFromListOn()
        self._surface_picker.AddPickList(self._membrane)

    def at(self, x: float, y: float) -> np.ndarray | None:
        """Point (3,) in B, without exaggeration, at a position in Qt pixels, or None."""
        ratio, picker = self._view.devicePixelRatioF(), self._surface_picker
        left, up = ratio * x, self._view.height() * ratio - ratio * y - 1.0
        if self._membrane.GetVisibility() and picker.Pick(left, up, 0.0, self._view.renderer):
            r, s, _ = picker.GetPCoords()
            return self._surface.true_point(picker.GetCellId(), np.array([1.0 - r - s, r, s]))
        return self._in_cloud(x, y) if self._cloud.GetVisibility() else None

    def _in_cloud(self, x: float, y: float) -> np.ndarray | None:
        """Point of the cloud nearest to the camera within `PICK_RADIUS` of a position."""
        points = _not_cut_away(self._cloud.mapper)
        size = np.array([self._view.width(), self._view.height()])
        seen = self._view.projected(points)
        off = 0.5 * size * (seen[:, :2] * (1, -1) + 1.0) - (x, y)
        near = np.linalg.norm(off, axis=1) <= PICK_RADIUS * np.linalg.norm(size)
        depth = np.where(near, seen[:, 2], np.inf)
        return np.array(points[np.argmin(depth)]) if near.any() else None


def _not_cut_away(mapper: Any) -> np.ndarray:
    """Points (k, 3) in B of a mapper that are not clipped."""
    points, planes = np.asarray(mapper.GetInput().points), mapper.GetClippingPlanes()
    for plane in planes or ():
        points = points[(points - plane.GetOrigin()) @ plane.GetNormal() >= 0.0]
    return points


# Section plane: clips the scene on one side.

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Section:
    """Clips actors by a plane and draws its intersection with the membrane.

    `actors`: To be clipped.
    """

    def __init__(self, view: View, surface: Surface, actors: list[Any]) -> None:
        self._plane = vtkPlane()
        self._actors, self._on = actors, False
        cutter = vtkCutter()
        cutter.SetInputData(surface.poly)
        cutter.SetCutFunction(self._plane)
        look = {"color": theme.ORANGE, "line_width": 3, "lighting": False}
        self._line = add_mark(view, cutter, -200.0, **look)
        self._line.visibility = False

    def apply(self, settings: Settings) -> None:
        """Apply the chosen section; none without an axis."""
        axis = settings.section_axis
        if axis is not None:
            sign = -1.0 if settings.section_flipped else 1.0
            normal = AXES[axis]
            self._plane.SetOrigin(*(settings.section_at_m * n for n in normal))
            self._plane.SetNormal(*(sign * n for n in normal))
        if self._on != (axis is not None):
            self._on = axis is not None
            for actor in self._actors:
                if self._on:
                    actor.mapper.AddClippingPlane(self._plane)
                else:
                    actor.mapper.RemoveAllClippingPlanes()
        on_surface = {"membrane", "wireframe", "contour"} & settings.layers
        self._line.visibility = self._on and bool(on_surface)


# Turntable: continuous rotation of the scene.

EVERY_MS = 33
DEGREES_A_SECOND = 30.0


class Turntable(QTimer):
    """While active, rotates the view about its up direction at a constant speed."""

    def __init__(self, view: View) -> None:
        super().__init__(view, timerType=Qt.TimerType.PreciseTimer, interval=EVERY_MS)
        self._view = view
        self.timeout.connect(self._turn)

    def set_turning(self, turning: bool) -> None:
        """Start or stop."""
        self._last_s = time.perf_counter()
        self.start() if turning else self.stop()

    def _turn(self) -> None:
        now = time.perf_counter()
        self._view.camera.Azimuth(DEGREES_A_SECOND * (now - self._last_s))
        self._last_s = now
        self._view.refresh()


# Picture of the 3-D view at any resolution.


def picture_of(view: View, width: int, height: int) -> np.ndarray:
    """Picture of the view, (height, width, 3) uint8; text scales with it.

    Marks under the mouse are hidden. VTK renders off-screen, so that nothing flashes up.
    """
    window = view.ren_win
    hidden = [prop for prop in view.pointer_props if prop.GetVisibility()]
    before, dpi = tuple(window.GetSize()), window.GetDPI()
    view.makeCurrent()
    try:
        for prop in hidden:
            prop.SetVisibility(False)
        window.SetSize(width, height)
        window.SetDPI(round(POINTS_PER_INCH * height / max(view.height(), 1)))
        window.Render()
        reader = vtkWindowToImageFilter()
        reader.SetInput(window)
        reader.ReadFrontBufferOff()
        reader.ShouldRerenderOff()
        reader.Update()
        pixels = vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars())
        return np.ascontiguousarray(pixels.reshape(height, width, 3)[::-1])
    finally:
        for prop in hidden:
            prop.SetVisibility(True)
        window.SetSize(*before)
        window.SetDPI(dpi)
        view.doneCurrent()
        view.refresh()


# Viewpoints: along the axes, and that of the depth camera.

Viewpoint = Literal["top", "side", "front", "camera"]
DIRECTIONS = {
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""Direction from the membrane to the camera, and up direction, in B."""
ANGLE_DEG = 30.0
"""Default view angle of VTK."""


def look_along(
    view: View, towards: ArrayLike, up: ArrayLike, points_m: np.ndarray, zoom: float = 1.0
) -> None:
    """Point the camera at points (k, 3) in B, all of them left of the colour bars.

    `towards, up`: (3,) array_like: Direction from the points to the camera, and up, in B.
    `zoom`: 1 fits the bounding box of the points.
    """
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    middle, camera = (low + high) / 2, view.camera
    camera.view_angle = ANGLE_DEG
    camera.focal_point = tuple(middle)
    camera.position = tuple(middle + np.asarray(towards))
    camera.up = tuple(np.asarray(up))
    view.renderer.ResetCamera(np.column_stack([low, high]).ravel())
    camera.zoom(zoom)
    _fit_beside_bars(view, points_m)


BORDER = 0.03
"""Free border of a fitted view, as a share of half the view."""


def _fit_beside_bars(view: View, points_m: np.ndarray) -> None:
    """Zoom out and pan until points (k, 3) fit left of the colour bars."""
    camera, free = view.camera, 2.0 * left_of_bars(view.width()) - 1.0
    camera.SetWindowCenter(0.0, 0.0)
    x, y, _ = view.projected(points_m).T
    left, right = float(x.min()), float(x.max())
    smaller = min(1.0, (1.0 - BORDER) / float(np.abs(y).max()))
    if smaller * right > free:
        smaller = min(smaller, (1.0 - BORDER + free) / (right - left))
    camera.zoom(smaller)
    camera.SetWindowCenter(max(smaller * right - free, 0.0), 0.0)


def look_through(view: View, camera: DepthCamera, far_m: float) -> None:
    """View from the depth camera, its image filling the view; focal point at `far_m`."""
    T, own = camera.T_B_C, camera.intrinsics
    vtk_camera = view.camera
    vtk_camera.position = tuple(T[:3, 3])
    vtk_camera.focal_point = tuple(T[:3, 3] + far_m * T[:3, 2])
    vtk_camera.up = tuple(-T[:3, 1])
    vtk_camera.SetWindowCenter(0.0, 0.0)
    tall = own.height / own.fy
    wide = own.width / own.fx * view.height() / max(view.width(), 1)
    vtk_camera.view_angle = math.degrees(2.0 * math.atan(0.5 * max(tall, wide)))
