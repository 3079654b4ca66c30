"""A plane that cuts the scene open: what is on one side of it is not drawn."""

from __future__ import annotations

from typing import Any

from vtkmodules.vtkCommonDataModel import vtkPlane
from vtkmodules.vtkFiltersCore import vtkCutter

from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.layers.drawn_surface import Surface
from bubbleviz_ui.view3d.layers.layer import add_mark
from bubbleviz_ui.view3d.render_view import View

AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Section:
    """Clips actors and draws the line along which the plane cuts the membrane.

    Parameters
    ----------
    view : View
    surface : Surface
    actors : sequence of actors
        Those that are cut.
    """

    def __init__(self, view: View, surface: Surface, actors: list[Any]) -> None:
        self._plane = vtkPlane()
        self._actors, self._on = actors, False
        cutter = vtkCutter()
        cutter.SetInputData(surface.poly)
        cutter.SetCutFunction(self._plane)
        look = {"color": theme.ORANGE, "line_width": 3, "lighting": False}
        self._line = add_mark(view, cutter, -200.0, **look)
        self._line.mapper.SetInputConnection(cutter.GetOutputPort())
        self._line.mapper.ScalarVisibilityOff()
        self._line.visibility = False

    def apply(self, choices: Choices) -> None:
        """Cut as the user chose; not at all without an axis."""
        axis = choices.section_axis
        if axis is not None:
            sign = -1.0 if choices.section_flipped else 1.0
            normal = AXES[axis]
            self._plane.SetOrigin(*(choices.section_at_m * n for n in normal))
            self._plane.SetNormal(*(sign * n for n in normal))
        if self._on != (axis is not None):
            self._on = axis is not None
            for actor in self._actors:
                if self._on:
                    actor.mapper.AddClippingPlane(self._plane)
                else:
                    actor.mapper.RemoveAllClippingPlanes()
        on_surface = {"membrane", "wireframe", "contour"} & choices.layers
        self._line.visibility = self._on and bool(on_surface)
