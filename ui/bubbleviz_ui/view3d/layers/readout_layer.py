"""Large text in the view: is there contact, how strong, how large."""

from __future__ import annotations

from typing import Any

from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz.result import Result
from bubbleviz_ui.model.result_text import DOUBTS, force_text
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_bar import bar_width
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import write_in

WIDEST = 420
"""Width of the longer line, pixels: where there is less beside the colour bars, text is smaller."""


class ReadoutLayer(Layer):
    """Two lines in the upper left corner: a headline and what belongs to it."""

    name = "readout"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._head = _text_actor(canvas.view, size=26, top=14)
        self._rest = _text_actor(canvas.view, size=15, top=50)
        self._alarm = _text_actor(canvas.view, size=26, top=14, colour=theme.UNTRUSTED)
        self.actors += [self._head, self._rest, self._alarm]

    def draw(self, picture: Picture) -> None:
        """Write the numbers of this result."""
        head, rest = readout(picture.result, self.canvas.units)
        doubtful = picture.result.estimate is not None and not picture.result.estimate.trusted
        self._head.SetInput("" if doubtful else head)
        self._alarm.SetInput(head if doubtful else "")
        self._rest.SetInput(rest)


def readout(result: Result, units: Units) -> tuple[str, str]:
    """Headline and second line for a result."""
    estimate, patch = result.estimate, result.patch
    if estimate is None or patch is None:
        return "", ""
    if not estimate.trusted:
        return DOUBTS[estimate.status], estimate.reason
    if estimate.status == "no_contact" or patch.area_m2 <= 0:
        return "no contact", ""
    peak = units.pressure.text(float(estimate.contact_pressure_pa.max()))
    area = units.area.with_range(patch.area_m2, *patch.area_interval_m2)
    return f"contact  {force_text(result, units)}", f"peak {peak}   patch {area}"


def _text_actor(view: View, *, size: int, top: int, colour: str | None = None) -> Any:
    actor = vtkTextActor()
    style = actor.GetTextProperty()
    write_in(view, style, size, colour)
    style.SetVerticalJustificationToTop()
    place = actor.GetPositionCoordinate()
    place.SetCoordinateSystemToNormalizedViewport()

    def put() -> None:
        """As a share of the height: text grows with the screen's scale and in pictures."""
        share = min(1.0, view.width() * (1.0 - bar_width(view)) / WIDEST)
        style.SetFontSize(round(share * size))
        place.SetValue(0.02, 1.0 - share * top / max(view.height(), 1))

    view.resized.connect(put)
    put()
    view.renderer.AddViewProp(actor)
    return actor
