"""Where plots and images are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

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

    Parameters
    ----------
    make : callable
        Makes the parts, once.
    spacing : int
        Between them, screen pixels.

    Attributes
    ----------
    seen : Signal
        It is on the screen from now on.
    canvas : pyqtgraph.GraphicsLayoutWidget or None
    """

    seen = Signal()

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
