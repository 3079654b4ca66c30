"""Large text in the view: is there contact, how strong, how large."""

from __future__ import annotations

import math
import textwrap
from typing import Any

from bubbleviz.result import Result
from bubbleviz_ui.model.result_text import DOUBTS, force_text, tangential_text
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_bar import beside_bars
from bubbleviz_ui.view3d.layers.layer import Canvas, Layer, Picture
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import text_at

LEFT = 0.02
"""Where text begins, as a share of the view's width."""
HEAD, REST = 26, 15  # px, of the fonts
TOP, BELOW = 14, 36  # px, above the headline, and from there to what belongs to it
SMALLEST, TALL = 0.75, 400
"""Share of these sizes in a low view, and height from which all is as large as it is, px."""
APART = "   "
"""Between what may be in lines of its own."""
HATCHED = "hatched: pressure without evidence of contact, not in the force"


class ReadoutLayer(Layer):
    """Lines in the upper left corner: a headline and what belongs to it."""

    name = "readout"

    def __init__(self, canvas: Canvas) -> None:
        super().__init__(canvas)
        self._head = _text_actor(canvas.view)
        self._rest = _text_actor(canvas.view)
        self._alarm = _text_actor(canvas.view, theme.UNTRUSTED)
        self.actors += [self._head, self._rest, self._alarm]
        self._about = ""
        canvas.view.rendering.connect(self._fit)

    def draw(self, picture: Picture) -> None:
        """Write the numbers of this result."""
        head, rest = readout(picture.result, self.canvas.units)
        doubtful = picture.result.estimate is not None and not picture.result.estimate.trusted
        self._head.SetInput("" if doubtful else head)
        self._alarm.SetInput(head if doubtful else "")
        self._about = rest

    def _fit(self) -> None:
        """Keep the text beside the colour bars: a smaller headline, more lines below it."""
        height = self.canvas.view.room[1]
        share = min(1.0, max(SMALLEST, height / TALL))
        head, rest, top = share * HEAD, share * REST, 1.0 - share * TOP / height
        for text in (self._head, self._alarm):
            _put(text, head, top)
            size = head * min(1.0, self._room_for(text))
            _put(text, size, top)
            rest = min(rest, size)
        _put(self._rest, rest, 1.0 - share * (TOP + BELOW) / height)
        self._rest.SetInput(self._about)
        if self._room_for(self._rest) < 1.0:
            parts = self._about.replace("\n", APART).split(APART)
            self._rest.SetInput("\n".join(map(self._wrapped, parts)))

    def _wrapped(self, line: str) -> str:
        """A line in as many as it needs."""
        self._rest.SetInput(line)
        share = self._room_for(self._rest)
        return line if share >= 1.0 else textwrap.fill(line, max(math.floor(share * len(line)), 1))

    def _room_for(self, text: Any) -> float:
        """Width beside the colour bars over that of a text."""
        view, box = self.canvas.view, [0.0] * 4
        text.GetBoundingBox(view.renderer, box)
        width = view.room[0]
        return width * (beside_bars(width) - LEFT) * view.pixel / max(box[1] - box[0], 1.0)


def readout(result: Result, units: Units) -> tuple[str, str]:
    """Headline, and the lines below it, for a result."""
    estimate, patch = result.estimate, result.patch
    if estimate is None or patch is None:
        return "", ""
    if not estimate.trusted:
        return DOUBTS[estimate.status], estimate.reason
    if estimate.status == "no_contact" or patch.area_m2 <= 0:
        return "no contact", ""
    peak = units.pressure.text(float(estimate.contact_pressure_pa.max()))
    area = units.area.with_range(patch.area_m2, *patch.area_interval_m2)
    patches = f"patch {area}"
    if result.object_patch is not None:
        by_object = units.area.text(result.object_patch.area_m2)
        patches = f"patch (white) {area}{APART}by object (green) {by_object}"
    tangential = f"tangential {tangential_text(result, units)}"
    unexplained = estimate.unexplained_pressure_pa
    hatched = f"\n{HATCHED}" if unexplained is not None and unexplained.any() else ""
    rest = f"peak {peak}{APART}{tangential}{APART}{patches}{hatched}"
    return f"contact  {force_text(result, units)}", rest


def _put(text: Any, size: float, top: float) -> None:
    text.GetTextProperty().SetFontSize(math.floor(size))
    text.GetPositionCoordinate().SetValue(LEFT, top)


def _text_actor(view: View, colour: str | None = None) -> Any:
    actor = text_at(view, REST, (LEFT, 1.0), colour)
    actor.GetTextProperty().SetVerticalJustificationToTop()
    view.renderer.AddViewProp(actor)
    return actor
