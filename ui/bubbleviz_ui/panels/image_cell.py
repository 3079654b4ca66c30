"""One image of numbers in the images panel: colours, their scale, and the marked place."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from PySide6.QtGui import QColor

from bubbleviz.colour.seen_colour import SeenColour
from bubbleviz.diagnostics.probe import Probed
from bubbleviz_ui.model.units import NOTHING, Unit, Units
from bubbleviz_ui.panels.plot_frame import HEAD
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.theme import NODE
from bubbleviz_ui.view3d.colour_maps import residual_colours
from bubbleviz_ui.view3d.scale_ranges import rounded_up

Kind = Literal["range", "around zero", "mask", "colour"]
MAPS = {"range": "viridis", "mask": "CET-L1", "colour": "CET-L1"}
"""Perceptually uniform (Smith and van der Walt 2015; Kovesi 2015)."""
NARROW = 18
"""Letters in a line of the narrowest cell."""
BLOCKS = 5
"""Squares of colour that stand for the scale in the text above."""


@dataclass(frozen=True)
class Picture:
    """An image by its title, its unit among the operator's, and how it is coloured."""

    title: str
    kind: Kind
    unit: Callable[[Units], Unit] | None = None


PICTURES = MappingProxyType(
    {
        "depth": Picture("Depth", "range", lambda u: u.length),
        "change": Picture("Change", "around zero", lambda u: u.length),
        "residual": Picture("Residual", "around zero", lambda u: u.fine_length),
        "noise": Picture("Noise σ", "range", lambda u: u.fine_length),
        "used": Picture("Pixels used", "mask"),
        "patch": Picture("Contact patch", "mask"),
        "colour": Picture("Colour", "colour"),
        "flow": Picture("Flow", "range", lambda u: u.pixels),
    }
)
"""What the panel can show, by name."""


def colour_map(kind: Kind, colours: theme.Colours) -> Any:
    """Map of pyqtgraph; what is around zero has the colours of residuals in the 3-D view."""
    import pyqtgraph as pg  # 0.2 s later than the window

    if kind == "around zero":
        return pg.ColorMap(None, residual_colours(colours.cloud))
    return pg.colormap.get(MAPS[kind])


class ImageCell:
    """An image with a line of text above and marks on it.

    Parameters
    ----------
    picture : Picture
    head : float
        Room for the text, screen pixels.

    Attributes
    ----------
    map : pyqtgraph.ColorMap
        In the theme's colours.
    """

    def __init__(self, picture: Picture, head: float = 2 * HEAD - 3) -> None:
        import pyqtgraph as pg  # 0.2 s later than the window

        self.picture = picture
        self.image: np.ndarray | None = None
        self._held: tuple[float, float] | None = None
        self._scale: tuple[float, float, Unit | None] | None = None
        self.box = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False)
        self.item = pg.ImageItem(axisOrder="row-major")
        self.map = colour_map(picture.kind, theme.DARK)
        self.halo = pg.ScatterPlotItem(size=13, pen=pg.mkPen("k", width=4), brush=None)
        self.pixel = pg.ScatterPlotItem(size=13, pen=pg.mkPen(theme.LINE, width=2), brush=None)
        self.node = pg.ScatterPlotItem(size=9, pen=pg.mkPen(NODE, width=2), symbol="+")
        for item in (self.item, self.halo, self.pixel, self.node):
            self.box.addItem(item)
        self.frame: Any = pg.GraphicsLayout()
        self.frame.layout.setContentsMargins(0, head, 0, 0)
        self.frame.addItem(self.box, 0, 0)
        self.words = pg.LabelItem(justify="left", size="9pt")
        self.words.setParentItem(self.frame)
        self.words.setPos(0.0, -2.0)
        self.text = ""

    def forget_range(self) -> None:
        """Find the colours' range anew, for another source."""
        self._held = None

    def draw(
        self,
        image: np.ndarray | None,
        ends: tuple[float, float] | None,
        units: Units,
        why: str = "",
    ) -> None:
        """Show an image (H, W) in SI whose usual values lie between two ends, or why none."""
        if image is None:
            self.clear()
            lines = [self.picture.title, *textwrap.wrap(why, NARROW)]
            self._write("<br>".join(lines) if why else f"{self.picture.title}: {NOTHING}")
            return
        low, high = self._range(ends)
        unit = None if self.picture.unit is None else self.picture.unit(units)
        self.show(image, low, high)
        self._scale = (low, high, unit)
        self._write(f"{self.picture.title}<br>{self.legend(*self._scale)}")

    def clear(self) -> None:
        """Show nothing."""
        self.image = None
        self.item.clear()
        self._write("")

    def show(self, image: np.ndarray, low: float, high: float) -> None:
        """Show an image (H, W) in SI with its colours from `low` to `high`."""
        self._put(image, image.astype(np.float32), levels=(low, high))

    def _put(self, image: np.ndarray, drawn: np.ndarray, **how: Any) -> None:
        """Draw an image; all of it is in sight where its size is another."""
        new = self.image is None or self.image.shape != image.shape
        self.image = image
        self.item.setImage(drawn, **how)
        if new:
            self.box.setRange(self.item.boundingRect(), padding=0.01)

    def mark(self, place: Probed | None) -> None:
        """Mark a place's pixel and where the camera sees its node."""
        pixel = place.pixel if place is not None else None
        ring = ([], []) if pixel is None else ([pixel[1] + 0.5], [pixel[0] + 0.5])
        for item in (self.halo, self.pixel):
            item.setData(*ring)
        if place is None:
            self.node.setData([], [])
        else:
            row, column = place.node_pixel
            self.node.setData([column + 0.5], [row + 0.5])

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        self.map = colour_map(self.picture.kind, theme.with_text(text))
        self.item.setLookupTable(self.map.getLookupTable(nPts=256))
        self.words.setAttr("color", text.name())
        if self._scale is not None and self.image is not None:
            self._write(f"{self.picture.title}<br>{self.legend(*self._scale)}")

    def _range(self, ends: tuple[float, float] | None) -> tuple[float, float]:
        """Ends of the colours: they grow with the data and never shrink."""
        if self.picture.kind == "mask" or ends is None:
            return 0.0, 1.0
        low, high = ends
        if self.picture.kind == "around zero":
            high = rounded_up(max(abs(low), abs(high), 1e-6))
            low = -high
        if self._held is not None:
            low, high = min(low, self._held[0]), max(high, self._held[1])
        self._held = (low, high if high > low else low + 1e-6)
        return self._held

    def legend(self, low: float, high: float, unit: Unit | None) -> str:
        """Scale of the colours, as HTML; yes and no without a unit."""
        colours = self.map.getLookupTable(nPts=BLOCKS)[:, :3]
        blocks = "".join(f'<span style="color:rgb({r},{g},{b})">█</span>' for r, g, b in colours)
        if unit is None:
            no, yes = (f"rgb({','.join(map(str, colours[k]))})" for k in (0, -1))
            return f'<span style="color:{yes}">█</span> yes <span style="color:{no}">█</span> no'
        ends = (f"{unit.of(end):.{_digits(unit.of(high - low))}f}" for end in (low, high))
        first, last = ends
        return f"{first} {blocks} {last} {unit.symbol}"

    def _write(self, text: str) -> None:
        self.text = text
        self.words.setText(text)


class ColourCell(ImageCell):
    """An image cell without a scale; says in words why there is no image."""

    def take(self, seen: SeenColour | None) -> None:
        """Show what the colour camera saw; None where nobody has looked yet."""
        if seen is None or seen.rgb is None:
            self.clear()
            why = [NOTHING] if seen is None else textwrap.wrap(seen.reason, NARROW)
            self._write("<br>".join([self.picture.title, *why]))
            return
        self._put(seen.rgb, seen.rgb, autoLevels=False)
        self._write(self.picture.title)

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colour of text."""
        self.words.setAttr("color", text.name())
        self._write(self.text)


def _digits(span: float) -> int:
    """Decimals that tell the ends of a span apart."""
    return max(0, 1 - math.floor(math.log10(span))) if span > 0 else 0
