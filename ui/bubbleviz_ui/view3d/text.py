"""Text in the 3-D view: one font, one colour."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz.diagnostics import Probed
from bubbleviz_ui.model.source_facts import pressure_text
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import ENTRIES, rgb
from bubbleviz_ui.view3d.render_view import View

VTK_FONT_FILE = 4
FONT = str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")
"""As matplotlib ships it: it has κ and ², VTK's own font has not."""
OPACITY = 0.7
"""Of the ground below text: it can be read over the membrane, which stays in sight."""


def text_at(
    view: View, size: int, place: tuple[float, float], colour: str | None = None
) -> vtkTextActor:
    """Text as `write_in` makes it, at a place in shares of the view; it is not in the view yet."""
    actor = vtkTextActor()
    write_in(view, actor.GetTextProperty(), size, colour)
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.GetPositionCoordinate().SetValue(*place)
    return actor


def write_in(
    view: View,
    style: Any,
    size: int,
    colour: str | None = None,
    ground: Literal["view", "field"] = "view",
) -> None:
    """Give a vtkTextProperty the window's font, a size in pixels, and a colour or the theme's.

    `ground` is what of the theme lies below the text.
    """
    style.SetFontFamily(VTK_FONT_FILE)
    style.SetFontFile(FONT)
    style.SetFontSize(size)
    style.SetBold(False)
    style.SetItalic(False)
    style.SetShadow(False)
    style.SetBackgroundOpacity(OPACITY)

    def paint(colours: theme.Colours) -> None:
        style.SetColor(*(c / 255 for c in rgb(colour or colours.text)))
        style.SetBackgroundColor(*(c / 255 for c in rgb(getattr(colours, ground))))

    view.follow_theme(paint)


# Numbers of a place, or a length, written there in the 3-D view.


SIZE = 13  # px


class PlaceText:
    """A few short lines that stay at their place however the scene is turned."""

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


# A colour bar with a title that names the quantity and its unit.


WIDTH = 112
"""Width that the widest title needs, px."""
HEIGHT, BORDER = 0.42, 0.04
"""Of a bar with its title, and of what is free above and below, as shares of the view's."""
EDGE = 0.01
"""Free beside the bars, as a share of the view's width."""
LEAST_BORDER = 15
"""How far the title reaches beyond the bar's height, px."""
TEXT, LINE = 12, 15  # px, of a font and of a line of it
TITLE = 2 * LINE + 6
"""Of a bar's height, px."""
LOWEST = 2 * (TITLE + LINE) + 3 * LEAST_BORDER
"""Height of a view with room for two bars, of two numbers each, px."""


def bar_width(width: float) -> float:
    """Width of the colour bars as a share of that of the view, px."""
    return min(max(0.11, WIDTH / max(width, 1.0)), 0.5)


def beside_bars(width: float) -> float:
    """What is left of the colour bars, as a share of the width of the view, px."""
    return 1.0 - bar_width(width) - 2.0 * EDGE


class ColourBar:
    """Colour bar in the upper or the lower half of the right edge of the view."""

    def __init__(self, view: View, table: Any, quantity: str, *, upper: bool) -> None:
        bar = vtkScalarBarActor()
        bar.SetLookupTable(table)
        bar.SetTitle(quantity)
        bar.SetLabelFormat("{:.4g}")
        bar.UnconstrainedFontSizeOn()
        bar.SetBarRatio(0.22)
        bar.SetMaximumNumberOfColors(ENTRIES)
        write_in(view, bar.GetTitleTextProperty(), TEXT)
        write_in(view, bar.GetLabelTextProperty(), TEXT)
        view.renderer.AddViewProp(bar)
        self._view, self._bar, self._upper = view, bar, upper
        self._table, self._quantity = table, quantity
        view.rendering.connect(self._fit)

    def set_range(self, low: float, high: float, unit: Unit) -> None:
        """Take other ends, in a unit, which the title names."""
        self._bar.SetTitle(f"{self._quantity}\n({unit.symbol})")
        if tuple(self._table.scalar_range) != (low, high):
            self._table.scalar_range = (low, high)

    def _fit(self) -> None:
        """Keep room for the title, and as many numbers as have some, however small the view is."""
        width, height = self._view.room
        share, border = bar_width(width), max(BORDER * height, LEAST_BORDER)
        tall = min(HEIGHT * height, (height - 3.0 * LEAST_BORDER) / 2.0)
        bottom = height - border - tall if self._upper else border
        self._bar.SetWidth(share)
        self._bar.SetHeight(tall / height)
        self._bar.SetPosition(1.0 - EDGE - share, bottom / height)
        lines = (tall - TITLE) / LINE
        self._bar.SetNumberOfLabels(next((n for n in (5, 3) if n - 1 <= lines), 2))
        self._bar.SetVerticalTitleSeparation(round(6 * self._view.pixel))

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
        self._bar.SetVisibility(visible)
