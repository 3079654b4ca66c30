"""Images panel: what the camera measured and what came of it, pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, QSize, Qt, QTimer
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QVBoxLayout, QWidget

from bubbleviz.diagnostics.probe import Probed
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.hover import Hover
from bubbleviz_ui.model.result_text import pressure_text
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.binding import menu_button
from bubbleviz_ui.panels.control_input import watch_controls
from bubbleviz_ui.panels.image_cell import PICTURES, ColourCell, ImageCell
from bubbleviz_ui.panels.plot_host import Part, PlotHost
from bubbleviz_ui.shell.layouts import BarLayout, Elided, fill

EVERY_MS = 150
"""While playing: colouring a large image takes some ms."""
ASPECT = 4 / 3
NARROWEST = 130
"""Column in which the scale above an image is whole, screen pixels."""
LEAST_WIDTH, SIZE = 290, QSize(360, 260)
HEADER = 65
"""Height of what is above the images, screen pixels."""


class ImagesPanel(QWidget):
    """Chosen images in a grid; the place under the mouse is marked in all of them and in 3-D."""

    def __init__(self, state: SessionState, controller: Controller, hover: Hover) -> None:
        super().__init__()
        self.setObjectName("images")
        self._state, self._controller, self._hover = state, controller, hover
        self._host = PlotHost(self._make, spacing=4)
        self._host.seen.connect(self._draw)
        self._arranged: list[tuple[str, int]] | None = None
        self.cells: dict[str, ImageCell] = {}
        self._due = QTimer(self, singleShot=True, interval=EVERY_MS)
        self._due.timeout.connect(self._draw)
        titles = {name: picture.title for name, picture in PICTURES.items()}
        tip = "What is shown, and so computed"
        self.choose, self.boxes = menu_button("Images", tip, state, "images", titles)
        self.lines = [Elided(Qt.TextElideMode.ElideRight) for _ in range(3)]
        self._lay_out()
        controller.shown.connect(self._on_shown)
        hover.changed.connect(self._on_hover)
        self._on_hover(None)
        watch_controls(self)
        state.source_changed.connect(self._on_source)
        state.choices_changed.connect(self._on_choices)

    def _lay_out(self) -> None:
        header, text = QWidget(), QWidget()
        fill(QVBoxLayout(text), *self.lines, margins=(0, 0, 0, 0), spacing=0)
        BarLayout(header, text, self.choose, margins=(0, 0, 0, 0))
        fill(QVBoxLayout(self), header, (self._host, 1), margins=(8, 4, 8, 4), spacing=4)
        self.setMinimumWidth(LEAST_WIDTH)

    # -- events -------------------------------------------------------------------------------

    def _on_source(self) -> None:
        for cell in self.cells.values():
            cell.forget_range()

    def _on_choices(self) -> None:
        self._arrange()
        self._draw()
        self._on_hover(self._hover.place)

    def _on_shown(self, _: object) -> None:
        if not self._state.playing:
            self._draw()
        elif not self._due.isActive():
            self._due.start()

    def _on_hover(self, place: Probed | None) -> None:
        for label, line in zip(self.lines, words(place, self._state.units), strict=True):
            label.setText(line)
        for name, cell in self.cells.items():
            cell.mark(place if self._has_pixels_of_depth(name) else None)

    def sizeHint(self) -> QSize:
        """Room for a row of images."""
        return SIZE

    def resizeEvent(self, event: QResizeEvent) -> None:
        """As large as the images can be."""
        super().resizeEvent(event)
        self._arrange()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Notice that the mouse has left the images."""
        if event.type() == QEvent.Type.Leave:
            self._hover.leave()
        return False

    # -- drawing ------------------------------------------------------------------------------

    def _make(self) -> list[Part]:
        self.cells = {
            name: (ColourCell if picture.kind == "colour" else ImageCell)(picture)
            for name, picture in PICTURES.items()
        }
        self._host.canvas.scene().sigMouseMoved.connect(self._on_mouse)
        self._host.canvas.installEventFilter(self)
        self._arrange()
        return list(self.cells.values())

    def _arrange(self) -> None:
        """Put the chosen images into the grid that shows them largest."""
        if self._host.canvas is None:
            return
        shown = [name for name in PICTURES if name in self._state.choices.images]
        columns = best_columns(len(shown), self.width(), self.height() - HEADER)
        if self._arranged == [(name, columns) for name in shown]:
            return
        self._arranged = [(name, columns) for name in shown]
        self._host.arrange([self.cells[name].frame for name in shown], columns)
        self._draw()

    def _draw(self) -> None:
        if not self._host.ready:
            return
        result, inspection = self._controller.result, self._controller.inspection
        images: dict[str, np.ndarray] = {**inspection.images}
        if result is not None and result.patch is not None:
            mask = result.patch.pixel_mask
            images |= {"patch": mask} if mask is not None else {}
        for name in self._state.choices.images:
            cell = self.cells[name]
            if isinstance(cell, ColourCell):
                cell.take(inspection.colour)
                continue
            ends = inspection.ends.get(name)
            why = (inspection.no_flow or inspection.reference) if name == "flow" else ""
            cell.draw(images.get(name), ends, self._state.units, why)

    def _on_mouse(self, place: QPointF) -> None:
        for name in self._state.choices.images:
            box = self.cells[name].box
            if box.sceneBoundingRect().contains(place) and self._has_pixels_of_depth(name):
                at = box.mapSceneToView(place)
                self._hover.at_pixel(math.floor(at.y()), math.floor(at.x()))
                return
        self._hover.leave()

    def _has_pixels_of_depth(self, name: str) -> bool:
        """Whether a pixel of an image is the one of the depth image."""
        if name == "flow":
            return False
        opened, colour = self._controller.client.opened, self._controller.inspection.colour
        if not isinstance(self.cells[name], ColourCell):
            return True
        return opened is not None and colour is not None and colour.aligned(opened.camera)


def words(place: Probed | None, units: Units) -> tuple[str, str, str]:
    """Three lines about a place, in the operator's units."""
    if place is None:
        return "Point at an image or the membrane:", "the same place lights up everywhere", ""
    length = units.length
    seen = f"pixel ({place.pixel[1]}, {place.pixel[0]})" if place.pixel else "outside the image"
    point = place.point_m if np.isfinite(place.point_m).all() else place.node_m
    x, y, z = (f"{length.of(float(c)):.{length.digits}f}" for c in point)
    return (
        f"{seen} · node {place.node} · depth {length.text(place.depth_m)}",
        f"x {x} · y {y} · z {z} {length.symbol}",
        f"u {length.text(place.displacement_m)} · {pressure_text(place, units)}",
    )


def best_columns(count: int, width: int, height: int) -> int:
    """Columns of a grid in which images of 4:3 are largest; 1 for none."""
    count = max(count, 1)

    def size(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, ASPECT * (height / rows))

    most = min(count, max(width // NARROWEST, 1))
    return max(range(1, most + 1), key=size)
