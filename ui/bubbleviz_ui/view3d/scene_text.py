"""Text in the 3-D view: one font, one colour."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import matplotlib

from bubbleviz_ui.shell import theme
from bubbleviz_ui.view3d.colour_maps import rgb
from bubbleviz_ui.view3d.render_view import View

VTK_FONT_FILE = 4
OPACITY = 0.7
"""Of the ground below text: it can be read over the membrane, which stays in sight."""


@cache
def font_file() -> str:
    """DejaVu Sans as matplotlib ships it: it has κ and ², VTK's own font has not."""
    return str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf")


def write_in(view: View, style: Any, size: int, colour: str | None = None) -> None:
    """Give a vtkTextProperty the window's font, a size in pixels, and a colour or the theme's."""
    style.SetFontFamily(VTK_FONT_FILE)
    style.SetFontFile(font_file())
    style.SetFontSize(size)
    style.SetBold(False)
    style.SetItalic(False)
    style.SetShadow(False)
    style.SetBackgroundOpacity(OPACITY)

    def paint(colours: theme.Colours) -> None:
        style.SetColor(*(c / 255 for c in rgb(colour or colours.text)))
        style.SetBackgroundColor(*(c / 255 for c in rgb(colours.view)))

    view.follow_theme(paint)
