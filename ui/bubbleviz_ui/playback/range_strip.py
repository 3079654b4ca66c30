"""Frame ranges on a timeline: shaded, and dragged at both ends by mouse or keyboard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PySide6.QtCore import QEvent, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QPushButton,
    QSizePolicy,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from bubbleviz.calibration import Ranges
from bubbleviz.diagnostics import Statistics, statistics
from bubbleviz.recordings import TimeAxis
from bubbleviz_ui.model.units import DASH, Unit
from bubbleviz_ui.playback.frame_ranges import tidy
from bubbleviz_ui.shell import theme

HEIGHT = 16
MARGIN = 7
"""Half of a slider's handle, so that frames lie under the slider's."""
REACH = 7
"""How near to a handle one must click, screen pixels."""
FAST = 10
"""Frames that Shift and an arrow key move by."""
KEYS = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Down: -FAST, Qt.Key.Key_Up: FAST}

Handle = tuple[int, int]
"""Number of a range, and 0 for its first frame or 1 for its last."""


class RangeStrip(QWidget):
    """Shaded ranges of frames.

    Drag an end to move it; drag over empty frames to add a range. By keyboard: Tab to the strip,
    Space for the next end, arrows to move it, Delete to take its range out.
    """

    edited = Signal(object, str)  # New ranges, and what was done in words

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("ranges")
        self.setFixedHeight(HEIGHT)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)
        self.setToolTip(
            "Contact-free frames. Drag an end to move it, drag elsewhere to add a range. Keys: "
            "Space next end, ← → move it (↑ ↓ by 10), Delete removes the range"
        )
        self._axis = TimeAxis(np.zeros(0))
        self.ranges: Ranges = ()
        self._moving: Ranges | None = None
        self._handle: Handle = (0, 1)
        self._from: int | None = None

    def set_ranges(self, axis: TimeAxis, ranges: Ranges) -> None:
        """Show ranges of a source whose frames lie on an axis."""
        self._axis, self.ranges, self._moving = axis, ranges, None
        self.update()

    def x_of(self, frame: int) -> float:
        """Where a frame lies, screen pixels."""
        return MARGIN + float(self._axis.places[frame]) * (self.width() - 2 * MARGIN)

    def sizeHint(self) -> QSize:
        """As high as a timeline."""
        return QSize(200, HEIGHT)

    def event(self, event: QEvent) -> bool:
        """Keep the keys that move an end from the playback's shortcuts."""
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            own = {*KEYS, Qt.Key.Key_Space, Qt.Key.Key_Delete}
            if event.key() in own and self.ranges:
                event.accept()
                return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Choose an end, move it, or take its range out."""
        key = Qt.Key(event.key())
        if not self.ranges:
            super().keyPressEvent(event)
        elif key in KEYS:
            number, end = self._known_handle()
            frame = self._end(self.ranges, (number, end)) + KEYS[key]
            self._tell(self._moved(self.ranges, (number, end), frame), "Move a range's end")
        elif key == Qt.Key.Key_Space:
            number, end = self._known_handle()
            place = (2 * number + end + 1) % (2 * len(self.ranges))
            self._handle = divmod(place, 2)
            self.update()
        elif key == Qt.Key.Key_Delete:
            number, _ = self._known_handle()
            self._tell(tuple(r for k, r in enumerate(self.ranges) if k != number), "Remove a range")
        else:
            super().keyPressEvent(event)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Take hold of an end, or begin a new range."""
        if event.button() != Qt.MouseButton.LeftButton or not len(self._axis):
            return
        handle = self._near(event.position().x())
        if handle is not None:
            self._handle, self._moving = handle, self.ranges
            self.setFocus()
        else:
            self._from = self._frame(event.position().x())

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Move what is held."""
        x = event.position().x()
        if not event.buttons() & Qt.MouseButton.LeftButton:
            near = self._near(x) is not None
            self.setCursor(
                Qt.CursorShape.SizeHorCursor if near else Qt.CursorShape.PointingHandCursor
            )
            return
        if self._from is not None:
            ends = sorted((self._from, self._frame(x)))
            self._moving = tidy([*self.ranges, (ends[0], ends[1] + 1)], len(self._axis))
        elif self._moving is not None:
            self._moving = self._moved(self.ranges, self._handle, self._frame(x))
        self.update()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """One drag is one change."""
        moving, added = self._moving, self._from is not None
        self._moving = self._from = None
        if moving is not None:
            self._tell(moving, "Add a range" if added else "Move a range's end")
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Frames in use shaded, their ends as handles."""
        painter = QPainter(self)
        colours = theme.of(self)
        painter.fillRect(QRectF(MARGIN, 6, self.width() - 2 * MARGIN, 4), QColor(colours.field))
        ranges = self.ranges if self._moving is None else self._moving
        shade = QColor(theme.FORCE)
        for number, (start, stop) in enumerate(ranges):
            left, right = self.x_of(start), self.x_of(stop - 1)
            shade.setAlpha(110)
            painter.fillRect(QRectF(left, 3, max(right - left, 1.0), 10), shade)
            for end, x in enumerate((left, right)):
                held = self.hasFocus() and self._known_handle() == (number, end)
                painter.fillRect(
                    QRectF(x - 2, 0, 4, HEIGHT), QColor(colours.accent if held else theme.FORCE)
                )
        painter.end()

    def _frame(self, x: float) -> int:
        return int(self._axis.nearest((x - MARGIN) / max(self.width() - 2 * MARGIN, 1)))

    def _near(self, x: float) -> Handle | None:
        distances = {
            (number, end): abs(self.x_of(self._end(self.ranges, (number, end))) - x)
            for number in range(len(self.ranges))
            for end in (0, 1)
        }
        nearest = min(distances, key=lambda h: distances[h], default=None)
        return nearest if nearest is not None and distances[nearest] <= REACH else None

    def _known_handle(self) -> Handle:
        number, end = self._handle
        return min(number, len(self.ranges) - 1), end

    @staticmethod
    def _end(ranges: Ranges, handle: Handle) -> int:
        start, stop = ranges[handle[0]]
        return stop - 1 if handle[1] else start

    def _moved(self, ranges: Ranges, handle: Handle, frame: int) -> Ranges:
        """Ranges with an end at another frame; it goes no further than the other end."""
        number, end = handle
        start, stop = ranges[number]
        moved = (start, max(frame, start) + 1) if end else (min(frame, stop - 1), stop)
        return tidy([r for k, r in enumerate(ranges) if k != number] + [moved], len(self._axis))

    def _tell(self, ranges: Ranges, what: str) -> None:
        if ranges != self.ranges:
            self.edited.emit(ranges, what)


# Statistics of the curves over the range on the timeline, to read and to copy.


ROW = 18  # px: a line of text
NUMBERS = {
    "mean": "mean",
    "standard_deviation": "standard deviation",
    "minimum": "minimum",
    "maximum": "maximum",
}
COPIED_DIGITS = 6


@dataclass(frozen=True)
class Curve:
    """What a column is about."""

    title: str
    unit: Unit
    values: np.ndarray  # (n,) array: In SI, of the frames in the range; NaN where nothing is known


class RangeTable(QTableWidget):
    """A column for each curve; hidden while no range is marked."""

    def __init__(self) -> None:
        super().__init__()
        # Copies the table; to be put where there is room, and seen as long as the table is
        self.copy = QPushButton("Copy table")
        self.copy.setToolTip("Copy mean, spread and extremes over the range, for a spreadsheet")
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.verticalHeader().setMinimumSectionSize(ROW)
        self.verticalHeader().setDefaultSectionSize(ROW)
        self.setRowCount(len(NUMBERS) + 1)
        self.setVerticalHeaderLabels([*NUMBERS.values(), "frames"])
        self._text = ""
        self.copy.clicked.connect(lambda: QApplication.clipboard().setText(self._text))
        self.show_range(0, 0, [], None, "")

    def show_range(
        self, first: int, last: int, curves: Sequence[Curve], kappa: float | None, sensor: str
    ) -> None:
        """Show the statistics of curves over the frames `first` to `last`; none: nothing.

        What nothing is known of is left out, such as a wrench that was not measured. κ, None where
        it is automatic, and the sensor are in the copied table alone.
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
        for k, (curve, known) in enumerate(columns):
            for row, text in enumerate(_shown(curve, known)):
                item = QTableWidgetItem(text)
                item.setTextAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
                self.setItem(row, k, item)
        self._fit()
        for widget in (self, self.copy):
            widget.setVisible(bool(columns))

    def _fit(self) -> None:
        """As high as its rows are."""
        self.resizeColumnsToContents()
        bar = self.horizontalScrollBar().sizeHint().height()
        head = self.horizontalHeader().sizeHint().height()
        rows = self.verticalHeader().length()
        self.setFixedHeight(head + rows + bar + 2 * self.frameWidth())


def _heading(curve: Curve) -> str:
    return f"{curve.title} ({curve.unit.symbol})"


def _shown(curve: Curve, known: Statistics) -> list[str]:
    """One decimal more than single values have."""
    numbers = [curve.unit.from_si(getattr(known, name)) for name in NUMBERS]
    digits = curve.unit.digits + 1
    texts = [f"{value:.{digits}f}" if np.isfinite(value) else DASH for value in numbers]
    frames = len(curve.values)
    return [*texts, str(frames) if known.frames == frames else f"{known.frames} of {frames}"]


def _as_text(
    title: str, columns: Sequence[tuple[Curve, Statistics]], made_by: tuple[str, str]
) -> str:
    """The table as spreadsheets take it; a cell is empty where there is no number."""
    lines = [[title, *(_heading(curve) for curve, _ in columns), "κ", "sensor"]]
    for name, words in NUMBERS.items():
        values = [curve.unit.from_si(getattr(known, name)) for curve, known in columns]
        lines.append(
            [words, *(f"{v:.{COPIED_DIGITS}g}" if np.isfinite(v) else "" for v in values), *made_by]
        )
    lines.append(["frames", *(str(known.frames) for _, known in columns), *made_by])
    return "\n".join("\t".join(line) for line in lines)
