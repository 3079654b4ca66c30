"""Base class of the calibration pages, and their number and image widgets."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtWidgets import QFormLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from bubbleviz.calibration import Step
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.model.registry import Colouring, ImageKind
from bubbleviz_ui.model.units import DASH, Unit, Units
from bubbleviz_ui.panels.images_panel import ImageCell
from bubbleviz_ui.panels.plot_host import HEADING, Part, PlotHost
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill


class Page(QWidget):
    """Page of one step: image, numbers and settings."""

    name = ""  # on its button
    title = ""
    task = ""  # instruction to the user, one sentence
    sets: tuple[str, ...] = ()  # settings changed on this page
    step: Step | None = None  # computed when the user proceeds to this page
    next_title = ""  # text of the button that leads to this page

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__()
        self.calibration, self.units = calibration, units
        self.column = QVBoxLayout(self)
        self.column.setContentsMargins(0, 0, 0, 0)
        self.column.setSpacing(6)
        heading, self.about = QLabel(self.title), QLabel(self.task, wordWrap=True)
        theme.bold(heading)
        theme.dim(self.about)
        fill(self.column, heading, self.about)

    def enter(self) -> None:
        """Compute the step when the user proceeds to this page."""
        if self.step is not None:
            self.calibration.reach(self.step, self.next_title)

    def is_done(self, answer: Answer) -> bool:
        """Whether an answer contains the results of this step."""
        return self.step is not None and answer.work.settings.last_step >= self.step

    def show_answer(self, answer: Answer) -> None:
        """Show the results of an answer."""
        raise NotImplementedError


WIDEST = "88.888 mm rms"
"""A number that fits in one line."""


class NumberForm(QWidget):
    """Form with named numbers."""

    def __init__(self) -> None:
        super().__init__()
        self._form = QFormLayout(self)
        self._form.setContentsMargins(0, 0, 0, 0)
        self._form.setHorizontalSpacing(14)
        self._form.setVerticalSpacing(2)
        self._form.setRowWrapPolicy(QFormLayout.RowWrapPolicy.WrapLongRows)
        self._labels: dict[str, QLabel] = {}

    def write(self, texts: Mapping[str, str]) -> None:
        """Show these numbers, and a dash for each other one shown before."""
        for name, text in (dict.fromkeys(self._labels, DASH) | dict(texts)).items():
            if name not in self._labels:
                self._labels[name] = label = theme.bold(QLabel(wordWrap=True))
                # else a row beside a long name is not wrapped, but its number is
                label.setMinimumWidth(label.fontMetrics().horizontalAdvance(WIDEST))
                self._form.addRow(name, label)
            self._labels[name].setText(text)

    def text(self, name: str) -> str:
        return self._labels[name].text()


# An image with its colour scale and the value under the mouse.

HEIGHT = 290
"""Height of the image with its scale, screen pixels."""


class ImageView(QWidget):
    """Shows one image; the wheel with Ctrl zooms, alone it scrolls the page; dragging pans."""

    def __init__(self, colouring: Colouring = "range") -> None:
        super().__init__()
        self._unit = Unit("", 1.0, 0)
        self._kind = ImageKind("", colouring)
        self._host = PlotHost(self._make)
        self._host.pointed.connect(self._on_mouse)
        self.title, self.value = QLabel(wordWrap=True), QLabel()
        theme.dim(self.value)
        row = fill(QHBoxLayout(), (self.title, 1), self.value)
        fill(QVBoxLayout(self), row, self._host, margins=(0, 0, 0, 0), spacing=3)

    @property
    def image(self) -> np.ndarray | None:
        """The image shown (H, W), SI."""
        return self._cell.image

    def show_image(
        self, title: str, image: np.ndarray | None, unit: Unit, low: float = 0.0, high: float = 1.0
    ) -> None:
        """Show an image (H, W) in SI with colours from `low` to `high`; None: no image."""
        self._host.prepare()
        self._unit = unit
        self.title.setText(title if image is not None else f"{title}: {DASH}")
        self.value.setText("")
        if image is None:
            self._cell.clear()
        else:
            self._cell.show(image, low, high, unit)

    def at(self, row: int, column: int) -> str:
        image = self.image
        if image is None or not (0 <= row < image.shape[0] and 0 <= column < image.shape[1]):
            return ""
        return f"({column}, {row}) {self._unit.text(float(image[row, column]))}"

    def _make(self) -> list[Part]:
        self._cell = ImageCell(self._kind, head=HEADING)
        self._host.arrange([self._cell.item])
        self._host.canvas.setFixedHeight(HEIGHT)
        self._host.canvas.viewport().installEventFilter(self)
        return [self._cell]

    def eventFilter(self, _: QObject, event: QEvent) -> bool:
        """Leave the wheel without Ctrl to the page."""
        if not isinstance(event, QWheelEvent):
            return False
        zooms = bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier)
        event.setAccepted(zooms)
        return not zooms

    def _on_mouse(self, place: QPointF | None) -> None:
        text = ""
        if place is not None:
            point = self._cell.box.mapSceneToView(place)
            text = self.at(math.floor(point.y()), math.floor(point.x()))
        self.value.setText(text)
