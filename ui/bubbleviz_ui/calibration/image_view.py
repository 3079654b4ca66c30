"""An image of numbers: coloured, with its scale, and the number under the mouse."""

from __future__ import annotations

from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QPointF, Qt
from PySide6.QtGui import QImage, QPixmap
from PySide6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from bubbleviz.files.png_writer import coloured
from bubbleviz_ui.model.units import NOTHING, Unit
from bubbleviz_ui.shell import theme

HEIGHT = 250
SCALE = (90, 10)
"""Width and height of the colour scale, screen pixels."""


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
        self.low, self.high, self.scale, self.value = (QLabel() for _ in range(4))
        self.value.setObjectName("dim")
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(0, 0, 0, 0)
        self._column.setSpacing(3)
        self._column.addWidget(self.title)
        row = QHBoxLayout()
        for label in (self.low, self.scale, self.high):
            row.addWidget(label)
        row.addStretch(1)
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
        shape = image.shape
        colours = coloured(image, low, high, diverging, largest=shape[1])
        new = self._item.image is None or self._item.image.shape[:2] != shape
        self._item.setImage(colours, levels=(0, 255))
        if new:
            self._box.autoRange(padding=0.02)
        self.low.setText(unit.text(low, signed=diverging))
        self.high.setText(unit.text(high, signed=diverging))
        ramp = np.tile(np.linspace(0.0, 1.0, SCALE[0]), (SCALE[1], 1))
        shown = np.ascontiguousarray(coloured(ramp, 0.0, 1.0, diverging))
        picture = QImage(shown.data, *SCALE, 3 * SCALE[0], QImage.Format.Format_RGB888)
        self.scale.setPixmap(QPixmap.fromImage(picture))

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

        view = pg.GraphicsView(background=theme.of(self).view)
        view.setFixedHeight(HEIGHT)
        self._box = pg.ViewBox(lockAspect=True, invertY=True, enableMenu=False)
        view.setCentralItem(self._box)
        self._item = pg.ImageItem(axisOrder="row-major")
        self._box.addItem(self._item)
        view.scene().sigMouseMoved.connect(self._on_mouse)
        view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.view = view
        self._column.insertWidget(1, view)

    def changeEvent(self, event: QEvent) -> None:
        """Follow the window's theme."""
        super().changeEvent(event)
        if event.type() == QEvent.Type.PaletteChange and self.layout() is not None and self._item:
            self.view.setBackground(theme.of(self).view)

    def _on_mouse(self, place: QPointF) -> None:
        point = self._box.mapSceneToView(place)
        self.value.setText(self.at(int(np.floor(point.y())), int(np.floor(point.x()))))
