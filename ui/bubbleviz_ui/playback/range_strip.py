"""Editable frame ranges below the timeline, and a table of statistics over a range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PySide6.QtCore import QRectF, Qt, Signal
from PySide6.QtGui import QColor, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QApplication, QSizePolicy, QWidget

from bubbleviz.calibration import Ranges, as_ranges, frame_numbers
from bubbleviz.diagnostics import Statistics, statistics
from bubbleviz.recordings import TimeAxis
from bubbleviz_ui.model.units import DASH, Unit
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import push_button
from bubbleviz_ui.shell.table import Table

HEIGHT = 16
MARGIN = 7
"""Left and right margin, half of a slider's handle, so that frames align with a slider."""
GRAB_RADIUS = 7
"""Largest distance of a click from a handle, screen pixels."""
Handle = tuple[int, int]
"""Index of a range, and 0 for its first or 1 for its last frame."""


class RangeStrip(QWidget):
    """Shaded ranges of frames: drag an end to move it, or over empty frames to add a range."""

    edited = Signal(object, str)  # New ranges, and a description of the change

    def __init__(self) -> None:
        super().__init__()
        self.setFixedHeight(HEIGHT)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setMouseTracking(True)
        self.setToolTip(
            "Contact-free frames. Drag an end to move it, drag elsewhere to add a range"
        )
        self._axis = TimeAxis(np.zeros(0))
        self.ranges: Ranges = ()
        self._dragged: Ranges | None = None  # While the button is pressed
        self._grabbed: Handle | None = None  # None: a new range, from `_pressed`
        self._pressed = 0

    def set_ranges(self, axis: TimeAxis, ranges: Ranges) -> None:
        """Show ranges of a source with this time axis."""
        self._axis, self.ranges, self._dragged = axis, ranges, None
        self.update()

    def x_at(self, frame: int) -> float:
        """Horizontal position of a frame, screen pixels."""
        return MARGIN + float(self._axis.places[frame]) * (self.width() - 2 * MARGIN)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Grab an end, or start a new range."""
        if event.button() == Qt.MouseButton.LeftButton and len(self._axis):
            x = event.position().x()
            self._grabbed, self._pressed = self._near(x), self._frame(x)
            self._dragged = self.ranges

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move the grabbed end, or extend the new range."""
        x = event.position().x()
        if not event.buttons() & Qt.MouseButton.LeftButton:
            near = self._near(x) is not None
            self.setCursor(
                Qt.CursorShape.SizeHorCursor if near else Qt.CursorShape.PointingHandCursor
            )
        elif self._dragged is not None:
            self._dragged = self._dragged_to(self._frame(x))
            self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """Emit the change of a completed drag."""
        dragged, self._dragged = self._dragged, None
        if dragged is not None and dragged != self.ranges:
            added = self._grabbed is None
            self.edited.emit(dragged, "Add a range" if added else "Move a range's end")
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the ranges with handles at their ends."""
        painter = QPainter(self)
        colours = theme.of(self)
        painter.fillRect(QRectF(MARGIN, 6, self.width() - 2 * MARGIN, 4), QColor(colours.field))
        shade = QColor(theme.FORCE)
        shade.setAlpha(110)
        for start, stop in self.ranges if self._dragged is None else self._dragged:
            left, right = self.x_at(start), self.x_at(stop - 1)
            painter.fillRect(QRectF(left, 3, max(right - left, 1.0), 10), shade)
            for x in (left, right):
                painter.fillRect(QRectF(x - 2, 0, 4, HEIGHT), QColor(theme.FORCE))
        painter.end()

    def _frame(self, x: float) -> int:
        return int(self._axis.nearest((x - MARGIN) / max(self.width() - 2 * MARGIN, 1)))

    def _near(self, x: float) -> Handle | None:
        """The end at a position."""
        distances = {
            (number, end): abs(self.x_at(frame) - x)
            for number, (start, stop) in enumerate(self.ranges)
            for end, frame in enumerate((start, stop - 1))
        }
        nearest = min(distances, key=lambda h: distances[h], default=None)
        return nearest if nearest is not None and distances[nearest] <= GRAB_RADIUS else None

    def _dragged_to(self, frame: int) -> Ranges:
        """Ranges with the grabbed end there, at most at the other end, or a new one up to there."""
        others = list(self.ranges)
        if self._grabbed is None:
            first, last = sorted((self._pressed, frame))
        else:
            number, end = self._grabbed
            start, stop = others.pop(number)
            first, last = (start, max(frame, start)) if end else (min(frame, stop - 1), stop - 1)
        return as_ranges(frame_numbers((*others, (first, last + 1))))


# Statistics of the curves over the range on the timeline.

NUMBERS = {
    "mean": "mean",
    "standard_deviation": "standard deviation",
    "minimum": "minimum",
    "maximum": "maximum",
}
COPIED_DIGITS = 6


@dataclass(frozen=True)
class Curve:
    """Values of a column of the table."""

    title: str
    unit: Unit
    values: np.ndarray  # (n,) SI values of the frames in the range; NaN where unknown


class RangeTable(Table):
    """Statistics with a column for each curve; hidden without a range."""

    def __init__(self) -> None:
        super().__init__()
        self._text = ""
        # placed by the owner; visible with the table
        self.copy = push_button(
            "Copy table",
            "Copy mean, spread and extremes over the range, for a spreadsheet",
            lambda: QApplication.clipboard().setText(self._text),
        )
        self.setRowCount(len(NUMBERS) + 1)
        self.setVerticalHeaderLabels([*NUMBERS.values(), "frames"])
        self.show_range(0, 0, [], None, "")

    def show_range(
        self, first: int, last: int, curves: Sequence[Curve], kappa: float | None, sensor: str
    ) -> None:
        """Show statistics of curves over the frames `first` to `last`; no curves: hide the table.

        Curves without known values are omitted. κ (None: automatic threshold) and sensor appear
        only in the copied table.
        """
        columns = [(curve, statistics(curve.values)) for curve in curves]
        columns = [column for column in columns if column[1].frames] or columns
        made_by = ("" if kappa is None else f"{kappa:g}", sensor)
        text = _as_text(f"Frames {first} to {last}", columns, made_by)
        if text == self._text:
            return
        self._text = text
        self.setColumnCount(len(columns))
        self.setHorizontalHeaderLabels([_heading(curve) for curve, _ in columns])
        for row, texts in enumerate(zip(*(_shown(*each) for each in columns), strict=True)):
            self.write(row, texts, right=range(len(columns)))
        # as high as the rows, or scrolled on a low screen
        least = self.full_height + self.horizontalScrollBar().sizeHint().height()
        self.setMaximumHeight(least)
        self.setMinimumHeight(least - self.verticalHeader().length())
        for widget in (self, self.copy):
            widget.setVisible(bool(columns))


def _heading(curve: Curve) -> str:
    return f"{curve.title} ({curve.unit.symbol})"


def _shown(curve: Curve, known: Statistics) -> list[str]:
    """Texts of a column, with one decimal more than single values."""
    numbers = [curve.unit.from_si(getattr(known, name)) for name in NUMBERS]
    digits = curve.unit.digits + 1
    texts = [f"{value:.{digits}f}" if np.isfinite(value) else DASH for value in numbers]
    frames = len(curve.values)
    return [*texts, str(frames) if known.frames == frames else f"{known.frames} of {frames}"]


def _as_text(
    title: str, columns: Sequence[tuple[Curve, Statistics]], made_by: tuple[str, str]
) -> str:
    """The table as tab-separated text for spreadsheets; unknown numbers are empty."""
    lines = [[title, *(_heading(curve) for curve, _ in columns), "κ", "sensor"]]
    for name, words in NUMBERS.items():
        values = [curve.unit.from_si(getattr(known, name)) for curve, known in columns]
        lines.append(
            [words, *(f"{v:.{COPIED_DIGITS}g}" if np.isfinite(v) else "" for v in values), *made_by]
        )
    lines.append(["frames", *(str(known.frames) for _, known in columns), *made_by])
    return "\n".join("\t".join(line) for line in lines)
