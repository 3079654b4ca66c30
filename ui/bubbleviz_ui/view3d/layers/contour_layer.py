"""The outline of the contact patch."""

from __future__ import annotations

from vtkmodules.vtkFiltersCore import vtkContourFilter

from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front


class ContourLayer(Layer):
    """Contour line on the displayed surface; VTK traces it along the triangles."""

    name, cut = "contour", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        surface = canvas.surface
        self._filter = vtkContourFilter()
        self._filter.SetInputData(surface.poly)
        self._filter.ComputeScalarsOff()
        self._filter.ComputeNormalsOff()
        self._filter.SetInputArrayToProcess(0, 0, 0, 0, surface.LEVEL)
        self._filter.SetValue(0, 0.0)
        line = self.add(self._filter, color=theme.LINE, line_width=3, lighting=False)
        # Straight from the filter: pyvista puts an algorithm in Python between, run every frame.
        line.mapper.SetInputConnection(self._filter.GetOutputPort())
        in_front(line, -200.0)
        self._has(False)

    def draw(self, picture: Picture) -> None:
        """Trace the edge of the patch; nothing without contact."""
        patch = picture.result.trusted_patch
        if patch is not None and patch.area_m2 > 0:
            self.canvas.surface.mark(patch.level)
        self._has(patch is not None and patch.area_m2 > 0)
