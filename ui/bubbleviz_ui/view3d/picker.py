"""What lies under a pixel of the 3-D view, by VTK; on the GUI thread, as all of VTK."""

from __future__ import annotations

from typing import Any

import numpy as np
from vtkmodules.vtkRenderingCore import vtkCellPicker, vtkPointPicker

from bubbleviz_ui.view3d.render_view import View

TOLERANCE = 0.004
"""How near to a measured point one must be, as a share of the view's diagonal."""


class Picker:
    """Finds points on surfaces, and points of clouds where no surface is.

    Parameters
    ----------
    view : View
    surfaces, clouds : sequence of actors
        Only those that are visible are picked.
    """

    def __init__(self, view: View, surfaces: list[Any], clouds: list[Any]) -> None:
        self._view = view
        self._picks = []
        for kind, actors in ((vtkCellPicker, surfaces), (vtkPointPicker, clouds)):
            picker = kind()
            picker.SetTolerance(TOLERANCE if kind is vtkPointPicker else 0.0)
            picker.PickFromListOn()
            for actor in actors:
                picker.AddPickList(actor)
            self._picks.append((picker, actors))

    def at(self, x: float, y: float) -> np.ndarray | None:
        """Point (3,) in B under a place of the view in Qt's pixels; None where nothing is."""
        ratio = self._view.devicePixelRatioF()
        left, up = ratio * x, self._view.height() * ratio - ratio * y - 1.0
        for picker, actors in self._picks:
            if any(actor.GetVisibility() for actor in actors) and picker.Pick(
                left, up, 0.0, self._view.renderer
            ):
                return np.array(picker.GetPickPosition())
        return None
