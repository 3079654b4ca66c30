"""The sensor beside the one that the scene is about: the same layers, placed by one matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkRenderingCore import vtkAssembly, vtkProp3D

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.drawn_layers import DrawnLayers
from bubbleviz_ui.view3d.layers.rim_layer import RimLayer
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scale_ranges import HeldRanges

LAYERS = frozenset({"membrane", "contour", "cloud", "force", "rim"})


class SecondScene:
    """Draws the results of a second sensor into the view, on the scales of the first.

    Parameters
    ----------
    view : View
    units : Units
    ranges : HeldRanges
        Of the scene, which has the colour bars.
    """

    def __init__(self, view: View, units: Units, ranges: HeldRanges) -> None:
        self._view = view
        before = set(view.renderer.GetViewProps())
        self._drawn = DrawnLayers(view, units, ranges, LAYERS)
        made = [prop for prop in view.renderer.GetViewProps() if prop not in before]
        self._assembly = _gathered(view, made)
        self._assembly.SetVisibility(False)

    def set_sensor(
        self, sensor: Sensor, mesh: MembraneMesh, T_B_here: np.ndarray, colour: str
    ) -> None:
        """Take the sensor, and where it is in the bubble frame of the scene's."""
        matrix = vtkMatrix4x4()
        matrix.DeepCopy(T_B_here.ravel().tolist())
        self._assembly.SetUserMatrix(matrix)
        self._assembly.SetVisibility(False)
        self._drawn.set_sensor(sensor, mesh)
        self._drawn.of(RimLayer).paint(colour)

    @property
    def visible(self) -> bool:
        """Whether it is in the view."""
        return bool(self._assembly.GetVisibility())

    def show(self, result: Result, choices: Choices) -> None:
        """Have the next picture show a result with what the user chose to see."""
        self._drawn.draw(result, choices)
        self._assembly.SetVisibility(True)

    def hide(self) -> None:
        """Show nothing."""
        self._drawn.hide()
        self._assembly.SetVisibility(False)
        self._view.refresh()


def _gathered(view: View, props: list[Any]) -> Any:
    """Assembly of the actors among some props; the rest, which are colour bars, is taken out."""
    assembly = vtkAssembly()
    for prop in props:
        view.renderer.RemoveViewProp(prop)
        if isinstance(prop, vtkProp3D):
            assembly.AddPart(prop)
    view.renderer.AddViewProp(assembly)
    return assembly
