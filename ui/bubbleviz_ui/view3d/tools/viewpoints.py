"""Where one can look from: along the axes, and as the depth camera does."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from bubbleviz.camera.depth_camera import DepthCamera
from bubbleviz_ui.view3d.colour_bar import beside_bars
from bubbleviz_ui.view3d.render_view import View

Viewpoint = Literal["top", "side", "front", "camera"]
DIRECTIONS = {
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    "side": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0)),
}
"""From the middle of the membrane to the eye, and what is up, in B."""
ANGLE_DEG = 30.0
"""View angle of a fresh VTK camera."""


def look_along(
    view: View, towards: ArrayLike, up: ArrayLike, points_m: np.ndarray, zoom: float = 1.0
) -> None:
    """Look at points (k, 3) in B, all of which have room beside the colour bars.

    Parameters
    ----------
    view : View
    towards, up : (3,) array_like
        From the middle of the points to the eye, and what is up, in B.
    points_m : (k, 3) array
    zoom : float
        How near; 1 shows the whole box around the points.
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


def _fit_beside_bars(view: View, points_m: np.ndarray) -> None:
    """Make the picture smaller, and move it left, until points (k, 3) fit beside the bars."""
    camera, free = view.camera, 2.0 * beside_bars(view.width()) - 1.0
    camera.SetWindowCenter(0.0, 0.0)
    x, y, _ = view.projected(points_m).T
    left, right = float(x.min()), float(x.max())
    smaller = min(1.0, 1.0 / float(np.abs(y).max()))
    if smaller * right > free:
        smaller = min(smaller, (1.0 + free) / (right - left))
    camera.zoom(smaller)
    camera.SetWindowCenter(max(smaller * right - free, 0.0), 0.0)


def look_as(view: View, camera: DepthCamera, far_m: float) -> None:
    """Look with the eye of the depth camera, its image filling the view; `far_m` ahead is focus."""
    T, own = camera.T_B_C, camera.intrinsics
    vtk_camera = view.camera
    vtk_camera.position = tuple(T[:3, 3])
    vtk_camera.focal_point = tuple(T[:3, 3] + far_m * T[:3, 2])
    vtk_camera.up = tuple(-T[:3, 1])
    vtk_camera.SetWindowCenter(0.0, 0.0)
    tall = own.height / own.fy
    wide = own.width / own.fx * view.height() / max(view.width(), 1)
    vtk_camera.view_angle = math.degrees(2.0 * math.atan(0.5 * max(tall, wide)))
