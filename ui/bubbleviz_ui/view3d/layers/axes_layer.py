"""How the bubble frame lies, and how long a length is."""

from __future__ import annotations

import math

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D, vtkTextActor

from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_maps import rgb
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import write_in

CORNER = 80
"""Side of the corner of the view that the axes take, px."""
SHARE = 0.16
"""Longest bar as a share of the view's width: beside it is room for the caption of a video."""
TICK, BOTTOM, TEXT = 5.0, 10.0, 13  # px


class AxesLayer(Layer):
    """Axes of B in a corner, and a scale bar beside them."""

    name = "axes"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._axes = canvas.view.add_axes(interactive=False, xlabel="x", ylabel="y", zlabel="z")
        for caption in (
            self._axes.GetXAxisCaptionActor2D(),
            self._axes.GetYAxisCaptionActor2D(),
            self._axes.GetZAxisCaptionActor2D(),
        ):
            write_in(canvas.view, caption.GetCaptionTextProperty(), TEXT)
            caption.GetTextActor().SetTextScaleModeToNone()
        scale = ScaleBar(canvas.view, canvas.units, left=CORNER)
        self.actors += [self._axes, *scale.actors]
        canvas.view.rendering.connect(self._fit)

    def _fit(self) -> None:
        """Keep the axes their size, however large the picture is."""
        width, height = self.canvas.view.room
        widget = self.canvas.view.renderer.axes_widget
        widget.SetViewport(0.0, 0.0, min(CORNER / width, 1.0), min(CORNER / height, 1.0))


class ScaleBar:
    """A round length (1, 2, 5 · 10ᵏ) at the bottom of the picture, as long as the picture allows.

    It is true in the depth of the point about which the view turns.

    Parameters
    ----------
    view : View
    units : Units
    left : float
        Where it begins, pixels.

    Attributes
    ----------
    actors : list
        To be shown or hidden together.
    """

    def __init__(self, view: View, units: Units, left: float) -> None:
        self._view, self._units, self._left = view, units, left
        self._bar = pv.PolyData(np.zeros((4, 3)), lines=[4, 0, 1, 2, 3])
        mapper = vtkPolyDataMapper2D()
        mapper.SetInputData(self._bar)
        self._line, self._label = vtkActor2D(), vtkTextActor()
        self._line.SetMapper(mapper)
        write_in(view, self._label.GetTextProperty(), TEXT)
        self.actors = [self._line, self._label]
        for actor in self.actors:
            view.renderer.AddViewProp(actor)
        view.follow_theme(self._paint)
        view.rendering.connect(self._fit)

    def _fit(self) -> None:
        """Choose the length, and draw it, for the picture that is about to be made."""
        (width, height), camera = self._view.room, self._view.camera
        pixel_m = 2.0 * camera.distance * math.tan(math.radians(camera.view_angle) / 2.0) / height
        length_m = _round_length(SHARE * width * pixel_m)
        left, right, top = self._left, self._left + length_m / pixel_m, BOTTOM + TICK
        ends = np.array([[left, top], [left, BOTTOM], [right, BOTTOM], [right, top]])
        self._bar.points[:, :2] = np.round(self._view.pixel * ends)
        self._bar.Modified()
        self._line.GetProperty().SetLineWidth(2.0 * self._view.pixel)
        unit = self._units.length
        self._label.SetInput(f"{unit.of(length_m):.4g} {unit.symbol}")
        self._label.SetPosition(self._view.pixel * left, self._view.pixel * (top + 2.0))

    def _paint(self, colours: theme.Colours) -> None:
        self._line.GetProperty().SetColor(*(c / 255 for c in rgb(colours.text)))


def _round_length(most_m: float) -> float:
    """Largest of 1, 2, 5 · 10ᵏ that is no longer."""
    decade = 10.0 ** math.floor(math.log10(most_m))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most_m)
