"""Images panel: depth image and derived images, with a probe."""

from __future__ import annotations

import math
import textwrap
from functools import cache
from typing import Any

import numpy as np
import pyqtgraph as pg
from matplotlib import colormaps
from PySide6.QtCore import QPointF, QSize, Qt
from PySide6.QtGui import QColor, QResizeEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget

from bubbleviz.diagnostics import Probed
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.engine.hover import Hover
from bubbleviz_ui.model.registry import IMAGES, Colouring, ImageKind
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.throttle import Throttle
from bubbleviz_ui.model.units import DASH, UNIT_CHOICES, Unit, Units
from bubbleviz_ui.panels.plot_host import HEADING, LEAST_HEIGHT, Cell, PlotHost
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import menu_button
from bubbleviz_ui.shell.dock import BarLayout, Elided, fill
from bubbleviz_ui.shell.theme import NODE
from bubbleviz_ui.view3d.colours import Scales, residual_colours, rounded_up
from bubbleviz_ui.view3d.tools import patch_text

# One image with its colour scale and the marked pixel.


VALUES = 256
"""Entries of a colour table."""
LINE_LETTERS = 18
"""Letters in a line of the narrowest cell."""
PAN_LIMIT = 2
"""How far an image can be panned or zoomed out, in widths and heights of what shows all of it."""
SCALE_STEPS = 5
"""Colour squares of the scale in the heading."""


@cache  # for seven images
def colour_table(colouring: Colouring, colours: theme.Colours) -> np.ndarray:
    """Colours (256, 3) uint8; signed images have the residual colours of the 3-D view."""
    if colouring == "around zero":
        return residual_colours(colours.cloud)[:, :3]
    # perceptually uniform (Smith and van der Walt 2015)
    table = colormaps["viridis" if colouring == "range" else "gray"](np.arange(VALUES), bytes=True)
    return np.asarray(table)[:, :3]


class ImageCell(Cell):
    """An image with a heading and marks.

    `head`: Height of the heading, screen pixels.
    """

    def __init__(self, kind: ImageKind, head: float = 2 * HEADING - 3) -> None:
        super().__init__(head=head)
        self.kind = kind
        self.image: np.ndarray | None = None
        self.range_so_far: tuple[float, float] | None = None  # Of the images of this source
        self._scale: tuple[float, float, Unit | None] | None = None
        self.box = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False)
        self.picture = pg.ImageItem(axisOrder="row-major")
        self.table = colour_table(kind.colouring, theme.DARK)
        self.halo = pg.ScatterPlotItem(size=13, pen=pg.mkPen("k", width=4), brush=None)
        self.pixel = pg.ScatterPlotItem(size=13, pen=pg.mkPen(theme.LINE, width=2), brush=None)
        self.node = pg.ScatterPlotItem(size=9, pen=pg.mkPen(NODE, width=2), symbol="+")
        for item in (self.picture, self.halo, self.pixel, self.node):
            self.box.addItem(item)
        self.item.addItem(self.box, 0, 0)
        self._fitted = True  # until the user zooms or pans
        self.box.sigRangeChangedManually.connect(self._on_zoomed)
        self.box.sigResized.connect(self._fit)

    def draw(
        self,
        image: np.ndarray | None,
        ends: tuple[float, float] | None,
        units: Units,
        why: str = "",
        scale: float | None = None,
    ) -> None:
        """Show an image (H, W) in SI with a colour range, or the reason for none.

        The range is ± `scale`, or grows with the `ends` of the images shown.
        """
        if image is None:
            self.clear()
            lines = [self.kind.title, *textwrap.wrap(why, LINE_LETTERS)]
            self.write("<br>".join(lines) if why else f"{self.kind.title}: {DASH}")
            return
        if self.kind.colouring == "colour":
            self._put(image, image, autoLevels=False)
            self.write(self.kind.title)
            return
        low, high = self._range(ends) if scale is None else (-scale, scale)
        unit: Unit | None = getattr(units, self.kind.unit) if self.kind.unit else None
        self.show(image, low, high, unit)

    def clear(self) -> None:
        self.image = None
        self.picture.clear()
        self.write("")

    def show(self, image: np.ndarray, low: float, high: float, unit: Unit | None) -> None:
        """Show an image (H, W) in SI with colours from `low` to `high`; no unit: yes or no."""
        self._put(image, image.astype(np.float32), levels=(low, high))
        self._scale = (low, high, unit)
        self.write(self._titled_scale(self._scale))

    def _titled_scale(self, scale: tuple[float, float, Unit | None]) -> str:
        return "<br>".join(filter(None, (self.kind.title, self.legend(*scale))))

    def _put(self, image: np.ndarray, drawn: np.ndarray, **how: Any) -> None:
        """Draw an image; one of another size is fitted into the view."""
        new = self.image is None or self.image.shape != image.shape
        self.image = image
        self.picture.setImage(drawn, **how)
        if new:
            self._fitted = True
            self._fit()

    def _fit(self, *_: object) -> None:
        """Limit panning and zooming out to the shape of the view, and show the whole image."""
        if self.image is None:
            return
        (height, width), view = self.image.shape[:2], self.box.size()
        wide = max(width, height * view.width() / max(view.height(), 1.0))
        high = max(height, width * view.height() / max(view.width(), 1.0))
        x, y = PAN_LIMIT * wide, PAN_LIMIT * high
        self.box.setLimits(xMin=-x, xMax=width + x, yMin=-y, yMax=height + y)
        if self._fitted:
            self.box.setRange(self.picture.boundingRect(), padding=0.01)

    def _on_zoomed(self, *_: object) -> None:
        self._fitted = False

    def mark(self, place: Probed | None) -> None:
        """Mark the pixel of a probed place and the projection of its point of the membrane."""
        pixel = place.pixel if place is not None else None
        ring = ([], []) if pixel is None else ([pixel[1] + 0.5], [pixel[0] + 0.5])
        for item in (self.halo, self.pixel):
            item.setData(*ring)
        if place is None:
            self.node.setData([], [])
        else:
            row, column = place.membrane_pixel
            self.node.setData([column + 0.5], [row + 0.5])

    def paint(self, dim: QColor, text: QColor) -> None:
        """Apply the theme's colours."""
        if self.kind.colouring != "colour":
            self.table = colour_table(self.kind.colouring, theme.with_text(text))
            self.picture.setLookupTable(self.table)
        if self._scale is not None and self.image is not None:
            self.text = self._titled_scale(self._scale)
        super().paint(dim, text)

    def _range(self, ends: tuple[float, float] | None) -> tuple[float, float]:
        """Colour range, which grows with the data and never shrinks."""
        if self.kind.colouring == "mask" or ends is None:
            return 0.0, 1.0
        low, high = ends
        if self.kind.colouring == "around zero":
            high = rounded_up(max(abs(low), abs(high), 1e-6))
            low = -high
        if self.range_so_far is not None:
            low, high = min(low, self.range_so_far[0]), max(high, self.range_so_far[1])
        self.range_so_far = (low, high if high > low else low + 1e-6)
        return self.range_so_far

    def legend(self, low: float, high: float, unit: Unit | None) -> str:
        """Colour scale as HTML; yes and no for a mask."""
        colours = self.table[np.linspace(0, VALUES - 1, SCALE_STEPS).astype(int)]
        blocks = "".join(f'<span style="color:rgb({r},{g},{b})">█</span>' for r, g, b in colours)
        if unit is None:
            no, yes = (f"rgb({','.join(map(str, colours[k]))})" for k in (0, -1))
            return f'<span style="color:{yes}">█</span> yes <span style="color:{no}">█</span> no'
        ends = (f"{unit.from_si(end):.{_digits(unit.from_si(high - low))}f}" for end in (low, high))
        first, last = ends
        return f"{first} {blocks} {last} {unit.symbol}"


def _digits(span: float) -> int:
    """Decimals that distinguish the ends of a span."""
    return max(0, 1 - math.floor(math.log10(span))) if span > 0 else 0


EVERY_MS = 150
"""Redraw period during playback; colouring a large image takes some ms."""
DRAWN = UNIT_CHOICES.keys() | {"images", "residual_max_m"}
"""Settings whose change redraws the images."""
ASPECT = 4 / 3
NARROWEST = 130
"""Smallest column in which the colour scale fits, screen pixels."""
LEAST_WIDTH, SIZE = 290, QSize(360, 260)
HEADER = 65
"""Height of the text above the images, screen pixels."""


class ImagesPanel(QWidget):
    """Chosen images in a grid; the place under the mouse is marked in all images and in 3-D."""

    def __init__(
        self, state: SessionState, controller: Controller, hover: Hover, scales: Scales
    ) -> None:
        super().__init__()
        self._scales, self._residual_max_m = scales, math.nan
        self._state, self._controller, self._hover = state, controller, hover
        self._host = PlotHost(spacing=4)  # each image is created when it is first chosen
        self._host.seen.connect(self._on_seen)
        self._host.pointed.connect(self._on_mouse)
        self.cells: dict[str, ImageCell] = {}
        self._redraw = Throttle(self, self._draw, EVERY_MS)
        self.choose, self.boxes = menu_button(state, "images")
        self.lines = [Elided(Qt.TextElideMode.ElideRight) for _ in range(3)]
        header, text = QWidget(), QWidget()
        fill(QVBoxLayout(text), *self.lines, margins=(0, 0, 0, 0), spacing=0)
        BarLayout(header, text, self.choose, margins=(0, 0, 0, 0))
        fill(QVBoxLayout(self), header, (self._host, 1), margins=(8, 4, 8, 4), spacing=4)
        self.setMinimumWidth(LEAST_WIDTH)
        self._host.setMinimumHeight(LEAST_HEIGHT)
        controller.shown.connect(self._on_shown)
        hover.changed.connect(self._on_hover)
        self._on_hover(None)
        state.source_changed.connect(self._on_source)
        state.follow(DRAWN, self._on_settings)
        state.history_changed.connect(self._on_history)

    # -- events -------------------------------------------------------------------------------

    def _on_source(self) -> None:
        for cell in self.cells.values():
            cell.range_so_far = None

    def _on_seen(self) -> None:
        self._arrange()
        self._draw()

    def _on_settings(self) -> None:
        self._on_seen()
        self._on_hover(self._hover.place)

    def _on_history(self) -> None:
        """Redraw if another frame has changed the scale of the residual."""
        if self._scales.of(self._state.settings).residual_m != self._residual_max_m:
            self._draw()

    def _on_shown(self, _: object) -> None:
        self._redraw.request() if self._state.playing else self._draw()

    def _on_hover(self, place: Probed | None) -> None:
        for label, line in zip(self.lines, probe_lines(place, self._state.units), strict=True):
            label.setText(line)
        for name, cell in self.cells.items():
            cell.mark(place if self._has_depth_pixels(name) else None)

    def sizeHint(self) -> QSize:
        """Size of one row of images."""
        return SIZE

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Rearrange the images to be as large as possible."""
        super().resizeEvent(event)
        self._arrange()

    # -- drawing ------------------------------------------------------------------------------

    def _cell(self, name: str) -> ImageCell:
        """The image of a name, created when it is first chosen."""
        if name not in self.cells:
            self.cells[name] = cell = ImageCell(IMAGES[name])
            self._host.add(cell)
        return self.cells[name]

    def _arrange(self) -> None:
        """Arrange the chosen images in the grid that shows them largest."""
        if self._host.canvas is None:
            return
        shown = [name for name in IMAGES if name in self._state.settings.images]
        columns = best_columns(len(shown), self.width(), self.height() - HEADER)
        self._host.arrange([self._cell(name).item for name in shown], columns)

    def _draw(self) -> None:
        if not self._host.ready:
            return
        result, inspection = self._controller.result, self._controller.inspection
        images: dict[str, np.ndarray | None] = {**inspection.images}
        if result.patch is not None:
            images["patch"] = result.patch.pixel_mask
        reasons = {"flow": inspection.no_flow or inspection.reference}
        if inspection.colour is not None:
            images["colour"], reasons["colour"] = inspection.colour.rgb, inspection.colour.reason
        for name in inspection.images.keys() - inspection.ends.keys():
            where = "" if name == "depth" else " on the membrane"
            images[name], reasons[name] = None, f"no returns{where} in this frame"
        self._residual_max_m = self._scales.of(self._state.settings).residual_m
        for name in self._state.settings.images:
            ends, why = inspection.ends.get(name), reasons.get(name, "")
            scale = self._residual_max_m if name == "residual" else None
            self._cell(name).draw(images.get(name), ends, self._state.units, why, scale)

    def _on_mouse(self, place: QPointF | None) -> None:
        for name in self._state.settings.images if place is not None else ():
            box = self._cell(name).box
            if box.sceneBoundingRect().contains(place) and self._has_depth_pixels(name):
                at = box.mapSceneToView(place)
                self._hover.point_at((math.floor(at.y()), math.floor(at.x())))
                return
        self._hover.point_at(None)

    def _has_depth_pixels(self, name: str) -> bool:
        """Whether the pixels of an image coincide with those of the depth image."""
        if name == "flow":
            return False
        opened, colour = self._controller.client.opened, self._controller.inspection.colour
        if name != "colour":
            return True
        return opened is not None and colour is not None and colour.aligned(opened.camera)


def probe_lines(place: Probed | None, units: Units) -> tuple[str, str, str]:
    """Three lines of text about a probed place."""
    if place is None:
        return "Point at an image or the membrane:", "the same place is marked everywhere", ""
    length = units.length
    seen = f"pixel ({place.pixel[1]}, {place.pixel[0]})" if place.pixel else "outside the image"
    point = place.point_m if np.isfinite(place.point_m).all() else place.membrane_m
    x, y, z = (f"{length.from_si(float(c)):.{length.digits}f}" for c in point)
    return (
        f"{seen} · node {place.node} · depth {length.text(place.depth_m)}",
        f"x {x} · y {y} · z {z} {length.symbol}",
        f"u {length.text(place.displacement_m)} · p_c {units.pressure.text(place.pressure_pa)} · "
        f"{patch_text(place)}",
    )


def best_columns(count: int, width: int, height: int) -> int:
    """Number of columns for which images of 4:3 are largest; 1 without images."""
    count = max(count, 1)

    def size(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, ASPECT * (height / rows))

    most = min(count, max(width // NARROWEST, 1))
    return max(range(1, most + 1), key=size)
