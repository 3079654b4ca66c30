"""A picture of the 3-D view at any resolution, from the same window VTK draws in."""

from __future__ import annotations

import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter

from bubbleviz_ui.view3d.render_view import POINTS_PER_INCH, View


def still(view: View, width: int, height: int) -> np.ndarray:
    """Picture of the view as it is, (height, width, 3) uint8; text grows with it.

    What the mouse points at is left out. VTK draws into a buffer of its own, so the window does not
    change and nothing flashes up.
    """
    window = view.ren_win
    left_out = [prop for prop in view.of_the_mouse if prop.GetVisibility()]
    before, dpi = tuple(window.GetSize()), window.GetDPI()
    view.makeCurrent()
    try:
        for prop in left_out:
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
        for prop in left_out:
            prop.SetVisibility(True)
        window.SetSize(*before)
        window.SetDPI(dpi)
        view.doneCurrent()
        view.refresh()
