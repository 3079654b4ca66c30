"""The outline of the contact patch, and how far off it may be."""

from __future__ import annotations

import math

from vtkmodules.vtkFiltersCore import vtkContourFilter

from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front


class ContourLayer(Layer):
    """Contour lines on the displayed surface; VTK traces them along the triangles.

    A thick line is the edge of the patch, thin ones are the band that holds the true edge.
    """

    name, cut = "contour", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._traced(line_width=3).SetValue(0, 0.0)
        self._band = self._traced(line_width=1, opacity=0.7)
        self._has(False)

    def _traced(self, **look: float) -> vtkContourFilter:
        surface, contour = self.canvas.surface, vtkContourFilter()
        contour.SetInputData(surface.poly)
        contour.ComputeScalarsOff()
        contour.ComputeNormalsOff()
        contour.SetInputArrayToProcess(0, 0, 0, 0, surface.LEVEL)
        line = self.add(contour, color=theme.LINE, lighting=False, **look)
        # Straight from the filter: pyvista puts an algorithm in Python between, run every frame.
        line.mapper.SetInputConnection(contour.GetOutputPort())
        in_front(line, -200.0)
        return contour

    def draw(self, picture: Picture) -> None:
        """Trace the edge of the patch and its band; nothing without contact."""
        patch = picture.result.trusted_patch
        if patch is not None and patch.area_m2 > 0:
            self.canvas.surface.mark(patch.level)
            band = patch.edge_half_width_m
            self._band.SetNumberOfContours(0 if math.isnan(band) else 2)
            if not math.isnan(band):
                self._band.SetValue(0, band)
                self._band.SetValue(1, -band)
        self._has(patch is not None and patch.area_m2 > 0)
