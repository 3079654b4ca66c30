"""Where plots and images are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, Protocol

from PySide6.QtCore import QEvent, Signal
from PySide6.QtGui import QColor, QPalette, QShowEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget


class Part(Protocol):
    """A plot or an image."""

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours of text."""


def import_plots() -> None:
    """Import pyqtgraph, which makes nothing of Qt by that: in a thread before the first plot."""
    import pyqtgraph  # noqa: F401  the window starts without


class PlotHost(QWidget):
    """A canvas of pyqtgraph, made when it is seen first.

    `make`: Makes the parts, once.
    `spacing`: Between them, screen pixels.
    """

    seen = Signal()  # It is on the screen from now on

    def __init__(self, make: Callable[[], Sequence[Part]], spacing: int = 2) -> None:
        super().__init__()
        self._make, self._spacing = make, spacing
        self._parts: Sequence[Part] = ()
        self.canvas: Any = None
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)

    @property
    def ready(self) -> bool:
        """Whether there is something to draw on, on the screen."""
        return self.canvas is not None and self.isVisible()

    def prepare(self) -> None:
        """Make the canvas and what is on it now."""
        if self.canvas is None:
            import pyqtgraph as pg  # 0.2 s later than the window

            self.canvas = pg.GraphicsLayoutWidget()
            self.canvas.ci.layout.setSpacing(self._spacing)
            self.canvas.ci.setContentsMargins(0, 0, 0, 0)
            self._column.addWidget(self.canvas)
            self._parts = self._make()
            self._paint()

    def arrange(self, items: Sequence[Any], columns: int = 1) -> None:
        """Put these items, and no others, into a grid."""
        self.canvas.ci.clear()
        for k, item in enumerate(items):
            self.canvas.ci.addItem(item, k // columns, k % columns)

    def let_go(self) -> None:
        """Close what would outlive the window, such as the menus of colour bars."""
        canvas, self.canvas = self.canvas, None
        for item in () if canvas is None else tuple(canvas.ci.items):
            item.close()

    def showEvent(self, event: QShowEvent) -> None:
        """Load the plotting library when it is needed first."""
        super().showEvent(event)
        self.prepare()
        self.seen.emit()

    def changeEvent(self, event: QEvent) -> None:
        """Follow the window's theme."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and self.canvas is not None:
            self._paint()

    def _paint(self) -> None:
        roles, palette = QPalette.ColorRole, self.palette()
        self.canvas.setBackground(palette.color(roles.Base))
        for part in self._parts:
            part.paint(palette.color(roles.PlaceholderText), palette.color(roles.Text))


# What every plot looks like: axes, grid, and a line of text above.
#
# pyqtgraph is imported with the first plot: the window starts 0.2 s earlier.


LEFT, BOTTOM, HEAD = 46, 20, 17
"""Room for the axes and the text, screen pixels."""
TICK = 56
"""Room for a time with its unit below a plot, screen pixels."""


class PlotFrame:
    """A plot that keeps its place whatever its text says.

    Of pyqtgraph's parts, without its `PlotItem`, which makes a dozen menus that outlive a window.

    `below`: What the axis below has.
    """

    def __init__(self, below: Literal["seconds", "logarithm", "number"]) -> None:
        import pyqtgraph as pg  # with the first plot

        self.box = pg.ViewBox(enableMenu=False)  # To put curves into
        timed = below == "seconds"
        self._axes = [pg.AxisItem("left"), _seconds() if timed else pg.AxisItem("bottom")]
        self._axes[1].setLogMode(below == "logarithm")
        self.item = pg.GraphicsLayout()  # To put into a scene
        self.item.setContentsMargins(0, HEAD, 4, 0)
        self.item.layout.setSpacing(0)
        self.item.layout.setContentsMargins(0, HEAD, 4, 0)
        self.item.addItem(self._axes[0], 0, 0)
        self.item.addItem(self.box, 0, 1)
        self.item.addItem(self._axes[1], 1, 1)
        for axis in self._axes:
            axis.linkToView(self.box)
            axis.enableAutoSIPrefix(False)
            axis.setGrid(40)
        self._axes[0].setWidth(LEFT)
        self._axes[1].setHeight(BOTTOM)
        self.text = ""  # What is written above, as HTML
        self.words = pg.LabelItem(justify="left", size="9pt")
        self.words.setParentItem(self.item)
        self.words.setPos(LEFT - 6.0, -2.0)

    def write(self, text: str) -> None:
        """Write above the plot."""
        self.text = text
        self.words.setText(text)

    def paint(self, dim: QColor, text: QColor) -> None:
        """Take the theme's colours."""
        for axis in self._axes:
            axis.setPen(dim)
            axis.setTextPen(dim)
        self.words.setAttr("color", text.name())
        self.write(self.text)


def _seconds() -> Any:
    """Axis whose ticks say that they are seconds."""
    import pyqtgraph as pg  # with the first plot

    class Seconds(pg.AxisItem):  # type: ignore[misc]
        def tickSpacing(self, first: float, last: float, size: float) -> list[tuple[float, float]]:
            (step, offset), *finer = super().tickSpacing(first, last, size)
            needed = TICK * (last - first) / max(size, 1.0)
            wide = next((n * step for n in (1, 2, 5, 10) if n * step >= needed), 10 * step)
            return [(wide, offset), *finer]

        def tickStrings(self, values: Any, scale: float, spacing: float) -> list[str]:
            return [f"{text} s" for text in super().tickStrings(values, scale, spacing)]

    return Seconds("bottom")
