"""How the bubble frame lies, and how long a length is."""

from __future__ import annotations

import math

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkBillboardTextActor3D

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Sensor
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture
from bubbleviz_ui.view3d.scene_text import write_in

CORNER = (0.0, 0.0, 0.13, 0.18)
"""Corner of the view that the axes take: x and y from, x and y to, as shares."""
TEXT = 13  # px
SHARE = 0.4
"""Longest scale bar as a share of the rim's width."""
BESIDE = 0.08
"""From the rim to the scale bar, as a share of the rim's width."""


class AxesLayer(Layer):
    """Axes of B in a corner, and a scale bar in the rim plane, in front of the rim."""

    name = "axes"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._bar = pv.PolyData(np.zeros((6, 3)), lines=[2, 0, 1, 2, 2, 3, 2, 4, 5])
        bar = self.add(self._bar, line_width=2, lighting=False)
        canvas.view.follow_theme(lambda colours: setattr(bar.prop, "color", colours.text))
        self._label = vtkBillboardTextActor3D()
        self._label.GetTextProperty().SetJustificationToCentered()
        self._label.GetTextProperty().SetVerticalJustificationToTop()
        self._label.SetDisplayOffset(0, -4)
        write_in(canvas.view, self._label.GetTextProperty(), TEXT)
        canvas.view.renderer.AddViewProp(self._label)
        self._axes = canvas.view.add_axes(
            interactive=False, viewport=CORNER, xlabel="x", ylabel="y", zlabel="z"
        )
        for caption in (
            self._axes.GetXAxisCaptionActor2D(),
            self._axes.GetYAxisCaptionActor2D(),
            self._axes.GetZAxisCaptionActor2D(),
        ):
            write_in(canvas.view, caption.GetCaptionTextProperty(), TEXT)
        self.actors += [self._label, self._axes]
        self._length_m = 0.0

    def set_sensor(self, sensor: Sensor, mesh: MembraneMesh) -> None:
        """Lay the scale bar beside the new rim."""
        rim = mesh.nodes[mesh.rim]
        low, high = rim.min(axis=0), rim.max(axis=0)
        wide = float(high[0] - low[0])
        self._length_m = _round_length(SHARE * wide)
        half, tick, y = 0.5 * self._length_m, 0.02 * wide, low[1] - BESIDE * wide
        x, z = 0.5 * (low[0] + high[0]), low[2]
        ends = np.array([[x - half, y, z], [x + half, y, z]])
        up = np.array([0.0, tick, 0.0])
        self._bar.points[:] = [*ends, ends[0] - up, ends[0] + up, ends[1] - up, ends[1] + up]
        self._bar.Modified()
        self._label.SetPosition(x, y - tick, z)

    def draw(self, picture: Picture) -> None:
        """Write the length in the operator's unit."""
        unit = self.canvas.units.length
        self._label.SetInput(f"{unit.of(self._length_m):.4g} {unit.symbol}")


def _round_length(most_m: float) -> float:
    """Largest of 1, 2, 5 · 10ᵏ that is no longer."""
    decade = 10.0 ** math.floor(math.log10(most_m))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most_m)
