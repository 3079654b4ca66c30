"""What every plot looks like: axes, grid, and a line of text above.

pyqtgraph is imported with the first plot: the window starts 0.2 s earlier.
"""

from __future__ import annotations

from typing import Any, Literal

from PySide6.QtGui import QColor

LEFT, BOTTOM, HEAD = 46, 20, 17
"""Room for the axes and the text, screen pixels."""
TICK = 56
"""Room for a time with its unit below a plot, screen pixels."""


class PlotFrame:
    """A plot that keeps its place whatever its text says.

    Of pyqtgraph's parts, without its `PlotItem`, which makes a dozen menus that outlive a window.

    Parameters
    ----------
    below : {"seconds", "logarithm", "number"}
        What the axis below has.

    Attributes
    ----------
    item : pyqtgraph.GraphicsLayout
        To put into a scene.
    box : pyqtgraph.ViewBox
        To put curves into.
    text : str
        What is written above, as HTML.
    """

    def __init__(self, below: Literal["seconds", "logarithm", "number"]) -> None:
        import pyqtgraph as pg

        self.box = pg.ViewBox(enableMenu=False)
        timed = below == "seconds"
        self._axes = [pg.AxisItem("left"), _seconds() if timed else pg.AxisItem("bottom")]
        self._axes[1].setLogMode(below == "logarithm")
        self.item = pg.GraphicsLayout()
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
        self.text = ""
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
    import pyqtgraph as pg

    class Seconds(pg.AxisItem):  # type: ignore[misc]
        def tickSpacing(self, first: float, last: float, size: float) -> list[tuple[float, float]]:
            (step, offset), *finer = super().tickSpacing(first, last, size)
            needed = TICK * (last - first) / max(size, 1.0)
            wide = next((n * step for n in (1, 2, 5, 10) if n * step >= needed), 10 * step)
            return [(wide, offset), *finer]

        def tickStrings(self, values: Any, scale: float, spacing: float) -> list[str]:
            return [f"{text} s" for text in super().tickStrings(values, scale, spacing)]

    return Seconds("bottom")
