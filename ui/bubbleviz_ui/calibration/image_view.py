"""An image of numbers: coloured, with its colour bar, and the number under the mouse."""

from __future__ import annotations

from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QPointF, Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from bubbleviz_ui.model.units import NOTHING, Unit
from bubbleviz_ui.shell import theme

HEIGHT, BAR = 290, 10
"""Of image and colour bar together, and of the bar alone, screen pixels."""
SEQUENTIAL, DIVERGING = "viridis", "CET-D1"
"""Perceptually uniform (Smith and van der Walt 2015; Kovesi 2015)."""


class ImageView(QWidget):
    """Shows one image at a time; the mouse wheel zooms, dragging moves it.

    Attributes
    ----------
    image : (H, W) array or None
        What is shown, SI.
    """

    def __init__(self) -> None:
        super().__init__()
        self.image: np.ndarray | None = None
        self._unit = Unit("", 1.0, 0)
        self._item: Any = None
        self.title = QLabel()
        self.title.setWordWrap(True)
        self.value = QLabel()
        self.value.setObjectName("dim")
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(3)
        row = QHBoxLayout()
        row.addWidget(self.title, 1)
        row.addWidget(self.value)
        self._column.addLayout(row)

    def show_image(
        self,
        title: str,
        image: np.ndarray | None,
        unit: Unit,
        low: float,
        high: float,
        *,
        diverging: bool = False,
    ) -> None:
        """Show an image (H, W) in SI with its colours from `low` to `high`; None: nothing."""
        self._prepare()
        self.image, self._unit = image, unit
        self.title.setText(title if image is not None else f"{title}: {NOTHING}")
        self.value.setText("")
        if image is None:
            self._item.clear()
            return
        new = self._item.image is None or self._item.image.shape != image.shape
        self._item.setImage((unit.per_si * image).astype(np.float32), autoLevels=False)
        self._bar.setColorMap(DIVERGING if diverging else SEQUENTIAL)
        self._bar.setLevels((unit.of(low), unit.of(high)))
        self._bar.getAxis("bottom").setLabel(unit.symbol)
        if new:
            self._box.autoRange(padding=0.02)

    def at(self, row: int, column: int) -> str:
        """Number of a pixel, in words."""
        if self.image is None:
            return ""
        height, width = self.image.shape
        if not (0 <= row < height and 0 <= column < width):
            return ""
        return f"({column}, {row}) {self._unit.text(float(self.image[row, column]))}"

    def _prepare(self) -> None:
        """Make the plot when there is something to show: pyqtgraph takes a while to load."""
        if self._item is not None:
            return
        import pyqtgraph as pg  # 0.2 s later than the window

        self.view = view = pg.GraphicsView()
        view.setFixedHeight(HEIGHT)
        layout = pg.GraphicsLayout()
        view.setCentralItem(layout)
        self._box = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False)
        layout.addItem(self._box, 0, 0)
        self._item = pg.ImageItem(axisOrder="row-major")
        self._box.addItem(self._item)
        self._bar = pg.ColorBarItem(
            width=BAR, orientation="h", interactive=False, colorMapMenu=False
        )
        self._bar.setImageItem(self._item)
        menu = self._bar.ctrlMenu  # its menu is never shown, and without a parent it never ends
        menu.setParent(view, menu.windowFlags())
        layout.addItem(self._bar, 1, 0)
        view.scene().sigMouseMoved.connect(self._on_mouse)
        view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._column.insertWidget(1, view)
        self._paint()

    def changeEvent(self, event: QEvent) -> None:
        """Follow the window's theme."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and self.layout() is not None and self._item:
            self._paint()

    def _paint(self) -> None:
        colours = theme.of(self)
        self.view.setBackground(colours.view)
        axis = self._bar.getAxis("bottom")
        axis.setPen(colours.dim)
        axis.setTextPen(colours.text)

    def _on_mouse(self, place: QPointF) -> None:
        point = self._box.mapSceneToView(place)
        self.value.setText(self.at(int(np.floor(point.y())), int(np.floor(point.x()))))
