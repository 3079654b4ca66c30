"""Numbers of a place, or a length, written there in the 3-D view."""

from __future__ import annotations

import math

import numpy as np
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz.diagnostics.probe import Probed
from bubbleviz_ui.model.result_text import pressure_text
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import write_in

SIZE = 13  # px


class PlaceText:
    """A few short lines that stay at their place however the scene is turned.

    Attributes
    ----------
    actor : vtkTextActor
    """

    def __init__(self, view: View, units: Units) -> None:
        self._view, self._units = view, units
        self._what: Probed | float | None = None
        self.actor = vtkTextActor()
        self.actor.GetPositionCoordinate().SetCoordinateSystemToWorld()
        self.actor.SetVisibility(False)
        write_in(view, self.actor.GetTextProperty(), SIZE, ground="field")
        view.renderer.AddViewProp(self.actor)

    def show(self, what: Probed | float | None, drawn_m: np.ndarray | None) -> None:
        """Write the numbers of a place, or a length in m, at `drawn_m` (3,) in B; or nothing."""
        self._what = what
        self.actor.SetVisibility(what is not None)
        if what is not None and drawn_m is not None:
            self.write()
            self.actor.GetPositionCoordinate().SetValue(*drawn_m)
            at, style = self._view.place_of(drawn_m), self.actor.GetTextProperty()
            # towards the middle of the view, where there is room
            right = at.x() > self._view.width() / 2
            style.SetJustificationToRight() if right else style.SetJustificationToLeft()
            low = at.y() > self._view.height() / 2
            up, down = style.SetVerticalJustificationToBottom, style.SetVerticalJustificationToTop
            up() if low else down()
        self._view.refresh()

    def write(self) -> None:
        """Write the numbers in the operator's units, which may be others by now."""
        if isinstance(self._what, Probed):
            self.actor.SetInput(beside(self._what, self._units))
        elif self._what is not None:
            self.actor.SetInput(f" {self._units.length.text(self._what)} ")


def beside(place: Probed, units: Units) -> str:
    """Lines about a place, in the operator's units; the residual only where it is known."""
    lines = [
        pressure_text(place, units),
        f"u {units.length.text(place.displacement_m)}",
        f"residual {units.fine_length.text(place.residual_m)}",
        f"node {place.node}",
    ]
    if math.isnan(place.residual_m):
        del lines[2]
    return "\n".join(f" {line} " for line in lines)
