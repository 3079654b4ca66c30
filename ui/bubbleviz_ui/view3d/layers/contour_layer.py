"""Outlines of contact patches: of the one that is shown, and of settings that are compared."""

from __future__ import annotations

import math

import numpy as np
import pyvista as pv

from bubbleviz.diagnostics.side_by_side import Measured
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import Surface, pairs
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture, in_front

CHUNK = 256
"""Lines have room for a multiple of so many pieces: VTK is slower where their number changes."""


class ContourLayer(Layer):
    """Contour lines on the displayed surface.

    A thick line is the edge of the patch, thin ones are the band that holds the true edge.
    """

    name, cut = "contour", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._edge = _Line(self, theme.LINE, line_width=3)
        self._band = _Line(self, theme.FAINT_LINE, line_width=1)
        self._has(False)

    def draw(self, picture: Picture) -> None:
        """Trace the edge of the patch and its band; nothing without contact."""
        patch, estimate = picture.result.trusted_patch, picture.result.estimate
        if patch is not None and patch.area_m2 > 0:
            surface, band = self.canvas.surface, patch.edge_half_width_m
            self._edge.draw(surface.edge(estimate, patch))
            levels = () if math.isnan(band) else (band, -band)
            self._band.draw(surface.edge(estimate, patch, levels))
        self._has(patch is not None and patch.area_m2 > 0)


class ObjectPatchLayer(Layer):
    """The edge of the patch by the object; nothing where its pose is lost."""

    name, cut = "object_patch", True

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._edge = _Line(self, theme.OBJECT_PATCH, -250.0, line_width=3)
        self._has(False)

    def draw(self, picture: Picture) -> None:
        """Trace the edge, where there is one."""
        patch = picture.result.object_patch
        if patch is not None:
            self._edge.draw(self.canvas.surface.line(patch.level))
        self._has(patch is not None)


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
        self._line = _Line(layer, colour, -300.0, line_width=2)
        self._mesh: MembraneMesh | None = None

    def draw(self, measured: Measured | None, exaggeration: float) -> None:
        patch = None if measured is None else measured.result.trusted_patch
        if measured is None or patch is None or patch.area_m2 == 0.0:
            self._line.draw(np.empty((0, 2, 3)))
            return
        if measured.mesh is not self._mesh:
            self._mesh = measured.mesh
            self._surface.set_mesh(measured.mesh)
        shape = self._surface.shape_of(measured.result.estimate, exaggeration)
        if shape is not None:
            self._surface.draw(shape)
        self._line.draw(self._surface.edge(measured.result.estimate, patch))


class _Line:
    """Straight pieces of a line in a buffer with spare room, whose pieces have no length."""

    def __init__(self, layer: Layer, colour: str, units: float = -200.0, **look: float) -> None:
        self._poly = pv.PolyData()
        self._reserve(1)
        self.actor = layer.add(self._poly, color=colour, lighting=False, **look)
        in_front(self.actor, units)

    def draw(self, pieces: np.ndarray) -> None:
        """Draw pieces (k, 2, 3) in B in place of those before."""
        self._reserve(len(pieces))
        ends = pieces.reshape(-1, 3)
        self._ends[: len(ends)] = ends
        self._ends[len(ends) :] = ends[-1] if len(ends) else self._ends[0]
        self._poly.Modified()

    def _reserve(self, count: int) -> None:
        room = -(-max(count, 1) // CHUNK) * CHUNK
        if 2 * room > self._poly.n_points:
            self._poly.points = np.zeros((2 * room, 3))
            self._poly.lines = pairs(room)
            self._ends = self._poly.points
