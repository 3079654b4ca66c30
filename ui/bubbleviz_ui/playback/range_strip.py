"""Editable frame ranges below the timeline, and a table of statistics over a range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PySide6.QtCore import QEvent, QRectF, Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import (
    QApplication,
    QSizePolicy,
    QWidget,
)

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
SHIFT_FRAMES = 10
"""Frames per press of ↑ or ↓."""
KEYS = {
    Qt.Key.Key_Left: -1,
    Qt.Key.Key_Right: 1,
    Qt.Key.Key_Down: -SHIFT_FRAMES,
    Qt.Key.Key_Up: SHIFT_FRAMES,
}

Handle = tuple[int, int]
"""Index of a range, and 0 for its first or 1 for its last frame."""


class RangeStrip(QWidget):
    """Shaded ranges of frames.

    Drag an end to move it; drag over empty frames to add a range. By keyboard: Tab to the strip,
    Space selects the next end, arrows move it, Delete removes its range.
    """

    edited = Signal(object, str)  # New ranges, and a description of the change

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("ranges")
        self.setFixedHeight(HEIGHT)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)
        self.setToolTip(
            "Contact-free frames. Drag an end to move it, drag elsewhere to add a range. Keys, "
            "after a click on an end: ← → move it (↑ ↓ by 10), Space next end, Delete removes the "
            "range"
        )
        self._axis = TimeAxis(np.zeros(0))
        self.ranges: Ranges = ()
        self._dragged_ranges: Ranges | None = None
        self._handle: Handle = (0, 1)
        self._drag_start: int | None = None

    def set_ranges(self, axis: TimeAxis, ranges: Ranges) -> None:
        """Show ranges of a source with this time axis."""
        self._axis, self.ranges, self._dragged_ranges = axis, ranges, None
        self.update()

    def x_at(self, frame: int) -> float:
        """Horizontal position of a frame, screen pixels."""
        return MARGIN + float(self._axis.places[frame]) * (self.width() - 2 * MARGIN)

    def event(self, event: QEvent) -> bool:
        """Claim the keys that move an end before the playback shortcuts."""
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            own = {*KEYS, Qt.Key.Key_Space, Qt.Key.Key_Delete}
            if event.key() in own and self.ranges:
                event.accept()
                return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Select or move an end, or remove its range."""
        key = Qt.Key(event.key())
        if not self.ranges:
            super().keyPressEvent(event)
        elif key in KEYS:
            number, end = self._valid_handle()
            frame = self._end(self.ranges, (number, end)) + KEYS[key]
            self._emit_edited(self._moved(self.ranges, (number, end), frame), "Move a range's end")
        elif key == Qt.Key.Key_Space:
            number, end = self._valid_handle()
            place = (2 * number + end + 1) % (2 * len(self.ranges))
            self._handle = divmod(place, 2)
            self.update()
        elif key == Qt.Key.Key_Delete:
            number, _ = self._valid_handle()
            self._emit_edited(
                tuple(r for k, r in enumerate(self.ranges) if k != number), "Remove a range"
            )
        else:
            super().keyPressEvent(event)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Grab an end, or start a new range."""
        if event.button() != Qt.MouseButton.LeftButton or not len(self._axis):
            return
        handle = self._near(event.position().x())
        if handle is not None:
            self._handle, self._dragged_ranges = handle, self.ranges
            self.setFocus()
        else:
            self._drag_start = self._frame(event.position().x())

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move the grabbed end, or extend the new range."""
        x = event.position().x()
        if not event.buttons() & Qt.MouseButton.LeftButton:
            near = self._near(x) is not None
            self.setCursor(
                Qt.CursorShape.SizeHorCursor if near else Qt.CursorShape.PointingHandCursor
            )
            return
        if self._drag_start is not None:
            first, last = sorted((self._drag_start, self._frame(x)))
            more = (*self.ranges, (first, last + 1))
            self._dragged_ranges = as_ranges(frame_numbers(more))
        elif self._dragged_ranges is not None:
            self._dragged_ranges = self._moved(self.ranges, self._handle, self._frame(x))
        self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """Emit the change of a completed drag."""
        moving, added = self._dragged_ranges, self._drag_start is not None
        self._dragged_ranges = self._drag_start = None
        if moving is not None:
            self._emit_edited(moving, "Add a range" if added else "Move a range's end")
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the ranges with handles at their ends."""
        painter = QPainter(self)
        colours = theme.of(self)
        painter.fillRect(QRectF(MARGIN, 6, self.width() - 2 * MARGIN, 4), QColor(colours.field))
        ranges = self.ranges if self._dragged_ranges is None else self._dragged_ranges
        shade = QColor(theme.FORCE)
        for number, (start, stop) in enumerate(ranges):
            left, right = self.x_at(start), self.x_at(stop - 1)
            shade.setAlpha(110)
            painter.fillRect(QRectF(left, 3, max(right - left, 1.0), 10), shade)
            for end, x in enumerate((left, right)):
                selected = self.hasFocus() and self._valid_handle() == (number, end)
                painter.fillRect(
                    QRectF(x - 2, 0, 4, HEIGHT), QColor(colours.accent if selected else theme.FORCE)
                )
        painter.end()

    def _frame(self, x: float) -> int:
        return int(self._axis.nearest((x - MARGIN) / max(self.width() - 2 * MARGIN, 1)))

    def _near(self, x: float) -> Handle | None:
        distances = {
            (number, end): abs(self.x_at(self._end(self.ranges, (number, end))) - x)
            for number in range(len(self.ranges))
            for end in (0, 1)
        }
        nearest = min(distances, key=lambda h: distances[h], default=None)
        return nearest if nearest is not None and distances[nearest] <= GRAB_RADIUS else None

    def _valid_handle(self) -> Handle:
        number, end = self._handle
        return min(number, len(self.ranges) - 1), end

    @staticmethod
    def _end(ranges: Ranges, handle: Handle) -> int:
        start, stop = ranges[handle[0]]
        return stop - 1 if handle[1] else start

    def _moved(self, ranges: Ranges, handle: Handle, frame: int) -> Ranges:
        """Ranges with one end moved, at most to the other end."""
        number, end = handle
        frame = min(max(frame, 0), len(self._axis) - 1)
        start, stop = ranges[number]
        moved = (start, max(frame, start) + 1) if end else (min(frame, stop - 1), stop)
        others = tuple(r for k, r in enumerate(ranges) if k != number)
        return as_ranges(frame_numbers((*others, moved)))

    def _emit_edited(self, ranges: Ranges, what: str) -> None:
        if ranges != self.ranges:
            self.edited.emit(ranges, what)


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
        self._fit()
        for widget in (self, self.copy):
            widget.setVisible(bool(columns))

    def _fit(self) -> None:
        """Be as high as the rows, or scroll on a low screen."""
        least = self.full_height + self.horizontalScrollBar().sizeHint().height()
        self.setMaximumHeight(least)
        self.setMinimumHeight(least - self.verticalHeader().length())


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
