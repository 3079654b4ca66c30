"""A colour bar with a title that names the quantity and its unit."""

from __future__ import annotations

from typing import Any

from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

from bubbleviz_ui.model.units import Unit
from bubbleviz_ui.view3d.colour_maps import ENTRIES
from bubbleviz_ui.view3d.render_view import View
from bubbleviz_ui.view3d.scene_text import write_in

WIDTH = 112
"""Width that the widest title needs, screen pixels."""


def bar_width(view: View) -> float:
    """Width of the colour bars as a share of the view's."""
    return min(max(0.11, WIDTH / max(view.width(), 1)), 0.5)


class ColourBar:
    """Colour bar at a fixed place at the right edge of the view.

    Parameters
    ----------
    view : View
    table : pyvista.LookupTable
    quantity : str
    bottom : float
        Lower end as a share of the view's height.
    """

    def __init__(self, view: View, table: Any, quantity: str, bottom: float) -> None:
        bar = vtkScalarBarActor()
        bar.SetLookupTable(table)
        bar.SetTitle(quantity)
        bar.SetNumberOfLabels(5)
        bar.SetLabelFormat("{:.4g}")
        bar.UnconstrainedFontSizeOn()
        bar.SetBarRatio(0.22)
        bar.SetVerticalTitleSeparation(6)
        bar.SetHeight(0.42)
        bar.SetMaximumNumberOfColors(ENTRIES)
        write_in(view, bar.GetTitleTextProperty(), 12)
        write_in(view, bar.GetLabelTextProperty(), 12)
        view.renderer.AddViewProp(bar)
        self._view, self._bar, self._bottom = view, bar, bottom
        self._table, self._quantity = table, quantity
        self._fit()
        view.resized.connect(self._fit)

    def set_range(self, low: float, high: float, unit: Unit) -> None:
        """Take other ends, in a unit, which the title names."""
        self._bar.SetTitle(f"{self._quantity}\n({unit.symbol})")
        if tuple(self._table.scalar_range) != (low, high):
            self._table.scalar_range = (low, high)

    def _fit(self) -> None:
        """Keep room for the title, however narrow the view is."""
        width = bar_width(self._view)
        self._bar.SetWidth(width)
        self._bar.SetPosition(0.99 - width, self._bottom)

    def set_visible(self, visible: bool) -> None:
        """Show or hide."""
        self._bar.SetVisibility(visible)
