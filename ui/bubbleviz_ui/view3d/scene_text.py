"""Text in the 3-D view: one font, one colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import matplotlib
from vtkmodules.vtkRenderingCore import vtkTextActor

from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_maps import rgb
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
