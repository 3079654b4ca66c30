"""Large text in the view: is there contact, how strong, how large."""

from __future__ import annotations

from typing import Any

import numpy as np
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz.result import Estimate, Patch
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import write_in

REASONS = {
    "no_contact": "no contact",
    "no_data": "no depth data",
    "not_converged": "solver did not converge",
}


class ReadoutLayer(Layer):
    """Two lines in the upper left corner: a headline and what belongs to it."""

    name = "readout"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._head = _text_actor(canvas.view, size=26, top=14)
        self._rest = _text_actor(canvas.view, size=15, top=50)
        self._actors += [self._head, self._rest]

    def draw(self, picture: Picture) -> None:
        """Write the numbers of this result."""
        head, rest = readout(picture.result.estimate, picture.result.patch, self.canvas.units)
        self._head.SetInput(head)
        self._rest.SetInput(rest)


def readout(estimate: Estimate | None, patch: Patch | None, units: Units) -> tuple[str, str]:
    """Headline and second line for a result."""
    if estimate is None or patch is None:
        return "", ""
    if estimate.status != "ok" or patch.area_m2 <= 0:
        return REASONS.get(estimate.status, "no contact"), ""
    force = units.force.text(float(np.linalg.norm(patch.force_n)))
    peak = units.pressure.text(float(estimate.contact_pressure_pa.max()))
    area = units.area.text(patch.area_m2)
    return f"contact  {force}", f"peak {peak}   patch {area}"


def _text_actor(view: View, *, size: int, top: int) -> Any:
    actor = vtkTextActor()
    style = actor.GetTextProperty()
    write_in(view, style, size)
    style.SetVerticalJustificationToTop()
    place = actor.GetPositionCoordinate()
    place.SetCoordinateSystemToNormalizedViewport()

    def put() -> None:
        """As a share of the height: text grows with the screen's scale and in pictures."""
        place.SetValue(0.02, 1.0 - top / max(view.height(), 1))

    view.resized.connect(put)
    put()
    view.renderer.AddViewProp(actor)
    return actor
