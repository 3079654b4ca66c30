"""Outlines of contact patches: of the one that is shown, and of settings that are compared."""

from __future__ import annotations

import math

from vtkmodules.vtkFiltersCore import vtkContourFilter

from bubbleviz.diagnostics.side_by_side import Measured
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import Surface
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front


class ContourLayer(Layer):
    """Contour lines on the displayed surface; VTK traces them along the triangles.

    A thick line is the edge of the patch, thin ones are the band that holds the true edge.
    """

    name, cut = "contour", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        surface = canvas.surface
        _traced(self, surface, theme.LINE, line_width=3).SetValue(0, 0.0)
        self._band = _traced(self, surface, theme.LINE, line_width=1, opacity=0.7)
        self._has(False)

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


class ComparedLayer(Layer):
    """Outlines of settings that are compared, in pictures of the frame that they were tried on."""

    name, cut = "compared", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._outlines = [_Outline(self, colour) for colour in theme.COMPARED]
        self._measured: tuple[Measured | str | None, ...] = (None, None)

    def take(self, measured: tuple[Measured | str | None, ...]) -> None:
        """Take what A and B were measured to be; anything but a `Measured` for none."""
        self._measured = measured

    def draw(self, picture: Picture) -> None:
        """Trace the patches of A and B, unless they are of another frame."""
        shown, larger = picture.result.frame.index, picture.choices.exaggeration
        for outline, one in zip(self._outlines, self._measured, strict=True):
            there = one if isinstance(one, Measured) else None
            if there is not None and there.result.frame.index != shown:
                there = None
            outline.draw(there, larger)


class _Outline:
    """The edge of a patch on the shape that its own setting found."""

    def __init__(self, layer: Layer, colour: str) -> None:
        self._surface = Surface(layer.canvas.units)
        self._contour = _traced(layer, self._surface, colour, -300.0, line_width=2)
        self._mesh: MembraneMesh | None = None

    def draw(self, measured: Measured | None, exaggeration: float) -> None:
        patch = None if measured is None else measured.result.trusted_patch
        if measured is None or patch is None or patch.area_m2 == 0.0:
            self._contour.SetNumberOfContours(0)
            return
        if measured.mesh is not self._mesh:
            self._mesh = measured.mesh
            self._surface.set_mesh(measured.mesh)
        shape = self._surface.shape_of(measured.result.estimate, exaggeration)
        if shape is not None:
            self._surface.draw(shape)
        self._surface.mark(patch.level)
        self._contour.SetValue(0, 0.0)


def _traced(
    layer: Layer, surface: Surface, colour: str, units: float = -200.0, **look: float
) -> vtkContourFilter:
    """Contour lines of a surface's level, drawn by a layer."""
    contour = vtkContourFilter()
    contour.SetInputData(surface.poly)
    contour.ComputeScalarsOff()
    contour.ComputeNormalsOff()
    contour.SetInputArrayToProcess(0, 0, 0, 0, surface.LEVEL)
    line = layer.add(contour, color=colour, lighting=False, **look)
    in_front(line, units)
    return contour
