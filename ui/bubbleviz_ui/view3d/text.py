"""Text and colour bars of the 3-D view."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import Any, Literal

import matplotlib
from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import Unit
from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colours import ENTRIES, rgb
from bubbleviz_ui.view3d.render_view import View

VTK_FONT_FILE = 4
FONT = str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")
"""From matplotlib; unlike VTK's own font it has κ and ²."""
OPACITY = 0.7
"""Of the text background, which keeps text readable over the membrane."""


def text_at(view: View, size: int, place: tuple[float, float]) -> vtkTextActor:
    """Text actor at a position in shares of the view; not added to the view."""
    actor = vtkTextActor()
    set_text_style(view, actor.GetTextProperty(), size)
    actor.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
    actor.GetPositionCoordinate().SetValue(*place)
    return actor


def set_colour(text: vtkTextActor, colour: str) -> None:
    """Set the colour of a text until the theme changes."""
    text.GetTextProperty().SetColor(*(c / 255 for c in rgb(colour)))


def set_text_style(
    view: View, style: Any, size: int, ground: Literal["view", "field"] = "view"
) -> None:
    """Set font and size in pixels of a vtkTextProperty; its colours follow the theme.

    `ground`: Background colour of the theme.
    """
    style.SetFontFamily(VTK_FONT_FILE)
    style.SetFontFile(FONT)
    style.SetFontSize(size)
    style.SetBold(False)
    style.SetItalic(False)
    style.SetShadow(False)
    style.SetBackgroundOpacity(OPACITY)

    def paint(colours: theme.Colours) -> None:
        style.SetColor(*(c / 255 for c in rgb(colours.text)))
        style.SetBackgroundColor(*(c / 255 for c in rgb(getattr(colours, ground))))

    view.follow_theme(paint)


def text_size(view: View, text: vtkTextActor) -> tuple[float, float]:
    """Width and height of a text, Qt pixels."""
    box = [0.0] * 4
    text.GetBoundingBox(view.renderer, box)
    return (box[1] - box[0]) / view.pixel_ratio, (box[3] - box[2]) / view.pixel_ratio


def wrap(view: View, text: vtkTextActor, line: str, width: float) -> str:
    """Set the text to a line, wrapped to a width in Qt pixels; returns it."""
    text.SetInput(line)
    share = width / max(text_size(view, text)[0], 1.0)
    if share < 1.0:
        text.SetInput(textwrap.fill(line, max(math.floor(share * len(line)), 1)))
    return str(text.GetInput())


# Colour bars.

WIDTH = 112
"""Width of the widest title, px."""
HEIGHT, BORDER = 0.42, 0.04
"""Height of a bar with its title, and of the border above and below, over the view's height."""
EDGE = 0.01
"""Margin on both sides of the bars, over the view's width."""
MIN_BORDER = 15
"""Smallest border, into which the title extends, px."""
TEXT, LINE = 12, 15  # px, font size and line height
TITLE = 2 * LINE + 6
"""Height of the title, px."""
MIN_HEIGHT = 2 * (TITLE + LINE) + 3 * MIN_BORDER
"""Height of a view that fits two bars with two numbers each, px."""


def bar_width(width: float) -> float:
    """Width of the colour bars as a share of the view's width, which is in px."""
    return min(max(0.11, WIDTH / max(width, 1.0)), 0.5)


def left_of_bars(width: float) -> float:
    """Width left of the colour bars as a share of the view's width, which is in px."""
    return 1.0 - bar_width(width) - 2.0 * EDGE


class ColourBar:
    """Colour bar in the upper or lower half of the view's right edge; a click locks its scale.

    `setting`: Of its upper end; None there: not locked.
    """

    def __init__(self, view: View, table: Any, quantity: str, setting: str, *, upper: bool) -> None:
        bar = vtkScalarBarActor()
        bar.SetLookupTable(table)
        bar.SetTitle(quantity)
        bar.SetLabelFormat("{:.4g}")
        bar.UnconstrainedFontSizeOn()
        bar.SetBarRatio(0.22)
        bar.SetMaximumNumberOfColors(ENTRIES)
        set_text_style(view, bar.GetTitleTextProperty(), TEXT)
        set_text_style(view, bar.GetLabelTextProperty(), TEXT)
        bar.SetVisibility(False)  # until there is a scale
        view.renderer.AddViewProp(bar)
        self._view, self._bar, self._upper, self._wanted = view, bar, upper, True
        self._table, self._quantity = table, quantity
        self.setting, self.end = setting, math.nan
        view.rendering.connect(self._fit)

    def set_range(
        self, end: float, unit: Unit, settings: Settings, *, signed: bool = False
    ) -> float:
        """Set the upper end, SI, and the title; returns the end in displayed units."""
        self.end, high = end, unit.from_si(end)
        low = -high if signed else 0.0
        locked = "" if getattr(settings, self.setting) is None else ", locked"
        self._bar.SetTitle(f"{self._quantity}\n({unit.symbol}){locked}")
        if tuple(self._table.scalar_range) != (low, high):
            self._table.scalar_range = (low, high)
        self._bar.SetVisibility(self._wanted)
        return high

    def contains(self, x: float, y: float) -> bool:
        """Whether it is visible at a position in the view, Qt pixels."""
        left, bottom = self._bar.GetPosition()
        across = x / self._view.width() - left
        up = 1.0 - y / self._view.height() - bottom
        inside = 0.0 <= across <= self._bar.GetWidth() and 0.0 <= up <= self._bar.GetHeight()
        return inside and bool(self._bar.GetVisibility())

    def _fit(self) -> None:
        """Adapt size and number of labels to the view."""
        width, height = self._view.size_px
        share, border = bar_width(width), max(BORDER * height, MIN_BORDER)
        tall = min(HEIGHT * height, (height - 3.0 * MIN_BORDER) / 2.0)
        bottom = height - border - tall if self._upper else border
        self._bar.SetWidth(share)
        self._bar.SetHeight(tall / height)
        self._bar.SetPosition(1.0 - EDGE - share, bottom / height)
        lines = (tall - TITLE) / LINE
        self._bar.SetNumberOfLabels(next((n for n in (5, 3) if n - 1 <= lines), 2))
        self._bar.SetVerticalTitleSeparation(round(6 * self._view.pixel_ratio))

    def set_visible(self, visible: bool) -> None:
        """Show, once it has a scale, or hide."""
        self._wanted = visible
        self._bar.SetVisibility(visible and not math.isnan(self.end))
