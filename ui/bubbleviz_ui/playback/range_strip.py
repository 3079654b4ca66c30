"""Frame ranges on a timeline: shaded, and dragged at both ends by mouse or keyboard."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QEvent, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QMouseEvent, QPainter, QPaintEvent
from PySide6.QtWidgets import QSizePolicy, QWidget

from bubbleviz.calibration.rest.frame_ranges import Ranges, tidy
from bubbleviz.frames.gaps import TimeAxis
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

    Attributes
    ----------
    edited : Signal
        New ranges, and what was done in words.
    """

    edited = Signal(object, str)

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("ranges")
        self.setFixedHeight(HEIGHT)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)
        self.setToolTip(
            "Contact-free frames. Drag an end, or an empty place for another range;"
            " keys: Space next end, ← → move it (↑ ↓ by 10), Delete takes the range out"
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
            self._tell(
                tuple(r for k, r in enumerate(self.ranges) if k != number), "Take a range out"
            )
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
