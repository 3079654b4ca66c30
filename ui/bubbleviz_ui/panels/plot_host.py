"""Widgets that hold pyqtgraph plots and images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, Protocol

import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, Signal
from PySide6.QtGui import QColor, QPalette, QShowEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget

LEAST_HEIGHT = 40
"""Height of plots and images while bars and other panels take their room, screen pixels."""


class Part(Protocol):
    """What follows the theme: a plot or an image."""

    def paint(self, dim: QColor, text: QColor) -> None:
        """Apply the theme's colours of secondary text and of text."""


def import_plots() -> None:
    """Import pyqtgraph before the first plot; creates no Qt objects, so a thread may do it."""
    pg.PlotDataItem  # noqa: B018  see `startup_imports`


class PlotHost(QWidget):
    """A pyqtgraph canvas, created when it is first shown.

    `make`: Creates the parts, once; others may be added later.
    `spacing`: Between them, screen pixels.
    """

    seen = Signal()  # The canvas became visible
    pointed = Signal(object)  # The mouse is at this `QPointF` of the canvas; None: it has left it
    clicked = Signal(object)  # The mouse event of pyqtgraph

    def __init__(self, make: Callable[[], Sequence[Part]] = tuple, spacing: int = 2) -> None:
        super().__init__()
        self._make, self._spacing = make, spacing
        self._parts: list[Part] = []
        self._arranged: tuple[list[Any], int, bool] | None = None
        self.canvas: Any = None
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)

    @property
    def ready(self) -> bool:
        """Whether the canvas exists and is visible."""
        return self.canvas is not None and self.isVisible()

    def prepare(self) -> None:
        """Create the canvas and its parts."""
        if self.canvas is None:
            self.canvas = pg.GraphicsLayoutWidget()
            self.canvas.ci.layout.setSpacing(self._spacing)
            self.canvas.ci.setContentsMargins(0, 0, 0, 0)
            self._column.addWidget(self.canvas)
            self.canvas.scene().sigMouseMoved.connect(self.pointed)
            self.canvas.scene().sigMouseClicked.connect(self.clicked)
            self.canvas.installEventFilter(self)
            self._parts += self._make()
            self._paint()

    def add(self, part: Part) -> None:
        """Have a part that was created after the canvas follow the theme."""
        self._parts.append(part)
        part.paint(*self._text_colours())

    def arrange(self, items: list[Any], columns: int = 1, *, filled: bool = False) -> bool:
        """Arrange the items in a grid, replacing all others; returns whether they were not yet.

        `filled`: the first item spans as many rows as leave no cell empty.
        """
        if self._arranged == (items, columns, filled):
            return False
        self._arranged = items, columns, filled
        self.canvas.ci.clear()
        higher = -len(items) % columns if filled else 0
        cells = [divmod(k, columns) for k in range(len(items) + higher)]
        free = [(row, column) for row, column in cells if column or not 0 < row <= higher]
        for item, cell in zip(items, free, strict=True):
            self.canvas.ci.addItem(item, *cell, rowspan=1 if any(cell) else 1 + higher)
        return True

    def showEvent(self, event: QShowEvent) -> None:
        """Create the canvas when first shown."""
        super().showEvent(event)
        self.prepare()
        self.seen.emit()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Detect that the mouse leaves the canvas."""
        if event.type() == QEvent.Type.Leave:
            self.pointed.emit(None)
        return False

    def changeEvent(self, event: QEvent) -> None:
        """Follow the window's theme."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and self.canvas is not None:
            self._paint()

    def _paint(self) -> None:
        self.canvas.setBackground(self.palette().color(QPalette.ColorRole.Base))
        for part in self._parts:
            part.paint(*self._text_colours())

    def _text_colours(self) -> tuple[QColor, QColor]:
        """Colours of secondary text and of text."""
        roles, palette = QPalette.ColorRole, self.palette()
        return palette.color(roles.PlaceholderText), palette.color(roles.Text)


# Common style of all plots: axes, grid, and a heading.

LEFT, RIGHT, BOTTOM, HEADING = 46, 4, 20, 17
"""Space for the axes, beside them, and for the heading, screen pixels."""
TICK_SPACING = 56
"""Smallest distance of time ticks, screen pixels."""


class Cell:
    """A plot or an image with a heading, in the grid of a `PlotHost`."""

    def __init__(self, left: float = 0.0, head: float = HEADING) -> None:
        self.item: Any = pg.GraphicsLayout()
        self.item.layout.setContentsMargins(0, head, 0, 0)
        self.text = ""  # Heading, as HTML
        self.label = pg.LabelItem(justify="left", size="9pt")
        self.label.setParentItem(self.item)
        self.label.setPos(left, -2.0)

    def write(self, text: str) -> None:
        self.text = text
        self.label.setText(text)

    def paint(self, dim: QColor, text: QColor) -> None:
        """Apply the theme's colours of secondary text and of text."""
        self.label.setAttr("color", text.name())
        self.write(self.text)


class Plot(Cell):
    """A plot of fixed layout with axes, grid and heading.

    Built without pyqtgraph's `PlotItem`, which creates a dozen menus that outlive a window.

    `below`, `left`: Quantities of the axes.
    `mouse`: Axes along which the mouse moves and zooms it.
    """

    def __init__(
        self,
        below: Literal["seconds", "logarithm", "number", "nothing"],
        *,
        left: Literal["number", "logarithm"] = "number",
        mouse: str = "",
    ) -> None:
        super().__init__(LEFT - 6.0)
        self.box = pg.ViewBox(enableMenu=False)  # Holds the curves
        self.box.setMouseEnabled(x="x" in mouse, y="y" in mouse)
        timed = below == "seconds"
        self._axes = [pg.AxisItem("left"), _seconds() if timed else pg.AxisItem("bottom")]
        for axis, quantity in zip(self._axes, (left, below), strict=True):
            axis.setLogMode(quantity == "logarithm")
        self._themed: list[tuple[Any, bool, int]] = []  # Item, whether as bright as text, width
        self.item.layout.setSpacing(0)
        self.item.layout.setContentsMargins(0, HEADING, RIGHT, 0)
        self.item.addItem(self._axes[0], 0, 0)
        self.item.addItem(self.box, 0, 1)
        self.item.addItem(self._axes[1], 1, 1)
        for axis in self._axes:
            axis.linkToView(self.box)
            axis.enableAutoSIPrefix(False)
            axis.setGrid(40)
        self._axes[0].setWidth(LEFT)
        self._axes[1].setHeight(0 if below == "nothing" else BOTTOM)

    def add_curve(self, colour: Any = None, *, width: int = 1, **look: Any) -> Any:
        """Add a curve, broken at NaN; without a colour in that of secondary text.

        `look`: Arguments of pyqtgraph's `mkPen`, or of `PlotDataItem` for symbols.
        """
        symbols = {name: look.pop(name) for name in [*look] if name.startswith("symbol")}
        curve = pg.PlotDataItem(connect="finite", **symbols)
        self.box.addItem(curve)
        if colour is None:
            self._themed.append((curve, False, width))
        else:
            curve.setPen(colour, width=width, **look)
        return curve

    def add_dots(self, size: int, colour: str, *, filled: bool = True) -> Any:
        """Add points, of a size in px."""
        brush, pen = (colour, None) if filled else (None, colour)
        dots = pg.ScatterPlotItem(size=size, brush=brush, pen=pen)
        self.box.addItem(dots)
        return dots

    def add_line(self, *, bright: bool = False, width: int = 1, **how: Any) -> Any:
        """Add a line across the plot, in the colour of text; arguments of `InfiniteLine`."""
        line = pg.InfiniteLine(**how)
        self.box.addItem(line, ignoreBounds=True)
        self._themed.append((line, bright, width))
        return line

    def paint(self, dim: QColor, text: QColor) -> None:
        """Apply the theme's colours."""
        super().paint(dim, text)
        for axis in self._axes:
            axis.setPen(dim)
            axis.setTextPen(dim)
        for item, bright, width in self._themed:
            item.setPen(text if bright else dim, width=width)


def _seconds() -> Any:
    """Time axis with ticks in s."""

    class Seconds(pg.AxisItem):  # type: ignore[misc]
        def tickSpacing(self, first: float, last: float, size: float) -> list[tuple[float, float]]:
            (step, offset), *finer = super().tickSpacing(first, last, size)
            needed = TICK_SPACING * (last - first) / max(size, 1.0)
            wide = next((n * step for n in (1, 2, 5, 10) if n * step >= needed), 10 * step)
            return [(wide, offset), *finer]

        def tickStrings(self, values: Any, scale: float, spacing: float) -> list[str]:
            return [f"{text} s" for text in super().tickStrings(values, scale, spacing)]

    return Seconds("bottom")
