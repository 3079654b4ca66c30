"""What lies under a pixel of the 3-D view; on the GUI thread, as all of VTK."""

from __future__ import annotations

from typing import Any

import numpy as np
from vtkmodules.vtkRenderingCore import vtkCellPicker

from bubbleviz_ui.view3d.render_view import View

TOLERANCE = 0.004
"""How near to a measured point one must be, as a share of the view's diagonal."""


class Picker:
    """Finds the place on a surface, or the point of a cloud where no surface is.

    What is hidden, or cut away by clipping planes, is not found.

    Parameters
    ----------
    view : View
    surface, cloud : actor
    """

    def __init__(self, view: View, surface: Any, cloud: Any) -> None:
        self._view, self._surface, self._cloud = view, surface, cloud
        self._on_surface = vtkCellPicker()
        self._on_surface.SetTolerance(0.0)
        self._on_surface.PickFromListOn()
        self._on_surface.AddPickList(surface)

    def at(self, x: float, y: float) -> np.ndarray | None:
        """Point (3,) in B under a place of the view in Qt's pixels; None where nothing is."""
        ratio, picker = self._view.devicePixelRatioF(), self._on_surface
        left, up = ratio * x, self._view.height() * ratio - ratio * y - 1.0
        if self._surface.GetVisibility() and picker.Pick(left, up, 0.0, self._view.renderer):
            return np.array(picker.GetPickPosition())
        return self._in_cloud(x, y) if self._cloud.GetVisibility() else None

    def _in_cloud(self, x: float, y: float) -> np.ndarray | None:
        """Point of the cloud nearest to the eye among those close to a place of the view."""
        points = _not_cut_away(self._cloud.mapper)
        size = np.array([self._view.width(), self._view.height()])
        seen = self._view.projected(points)
        off = 0.5 * size * (seen[:, :2] * (1, -1) + 1.0) - (x, y)
        near = np.linalg.norm(off, axis=1) <= TOLERANCE * np.linalg.norm(size)
        depth = np.where(near, seen[:, 2], np.inf)
        return np.array(points[np.argmin(depth)]) if near.any() else None


def _not_cut_away(mapper: Any) -> np.ndarray:
    """Points (k, 3) in B of what a mapper draws, on the kept side of its clipping planes."""
    points, planes = np.asarray(mapper.dataset.points), mapper.GetClippingPlanes()
    for plane in planes or ():
        points = points[(points - plane.GetOrigin()) @ plane.GetNormal() >= 0.0]
    return points
