"""A colour bar with a title that names the quantity and its unit."""

from __future__ import annotations

from typing import Any

from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

from bubbleviz_ui.model.units import Unit
from bubbleviz_ui.view3d.colour_maps import ENTRIES
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import write_in

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
    """Colour bar in the upper or the lower half of the right edge of the view.

    Parameters
    ----------
    view : View
    table : pyvista.LookupTable
    quantity : str
    upper : bool
    """

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
