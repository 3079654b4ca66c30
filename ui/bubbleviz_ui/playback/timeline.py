"""The timeline: frames, contact, gaps, markers, played range and cursor."""

from __future__ import annotations

from itertools import chain, count

import numpy as np
from PySide6.QtCore import QEvent, QLineF, QPointF, QRectF, Qt, Signal
from PySide6.QtGui import (
    QBrush,
    QColor,
    QHelpEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPolygonF,
)
from PySide6.QtWidgets import QSizePolicy, QToolTip, QWidget

from bubbleviz.recordings import Gap, TimeAxis
from bubbleviz.wording import count_of
from bubbleviz_ui.model.frame_history import CONTACT, FREE, UNKNOWN, UNTRUSTED
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.playback.range_strip import GRAB_RADIUS, MARGIN
from bubbleviz_ui.shell import theme

RULER = 16
"""Height of the upper band with times, markers and the played range."""
BAND = 22
"""Height of the lower band with the frames."""
TICK_PIXELS = 5
"""Smallest distance of ticks."""
HATCHED_FROM = 4
"""Gaps wider than this are hatched, narrower ones solid, screen pixels."""
LABEL_PIXELS = 70  # px for one time
STEPS_S = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1800, 3600)
CONTACT_TEXTS = {
    UNKNOWN: "not computed yet",
    FREE: "no contact",
    CONTACT: "contact",
    UNTRUSTED: "not trusted",
}


class Timeline(QWidget):
    """Frames over time; click or drag in the lower band to seek, in the upper to set a range.

    Painting time is independent of the number of frames: contact is reduced to one value per
    screen column.
    """

    range_dragged = Signal(object)  # First and last frame

    def __init__(self, state: SessionState) -> None:
        super().__init__()
        self._state = state
        self._fixed_end: int | None = None
        self._dragged: tuple[int, int] | None = None
        self.setFixedHeight(RULER + BAND)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)

    def x_at(self, frame: int) -> float:
        """Horizontal position of a frame, screen pixels."""
        return MARGIN + float(self._axis.places[frame]) * self._span

    def frame_at(self, x: float) -> int:
        return int(self._axis.nearest((x - MARGIN) / self._span))

    # -- mouse --------------------------------------------------------------------------------

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Seek, start a range, or grab an end of the range."""
        if event.button() != Qt.MouseButton.LeftButton:
            return
        x, frame = event.position().x(), self.frame_at(event.position().x())
        shift = bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
        if event.position().y() < RULER or shift:
            self._fixed_end = self._other_end(x)
            if self._fixed_end is None:
                self._fixed_end = frame
        else:
            self._state.seek(frame)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Seek or drag the range while the button is pressed."""
        x, ruler = event.position().x(), event.position().y() < RULER
        if not event.buttons() & Qt.MouseButton.LeftButton:
            end = ruler and self._other_end(x) is not None
            self.setCursor(Qt.CursorShape.SizeHorCursor if end else Qt.CursorShape.ArrowCursor)
        elif self._fixed_end is not None:
            first, last = sorted((self._fixed_end, self.frame_at(x)))
            self._dragged = (first, last)
            self.update()
        else:
            self._state.seek(self.frame_at(x))

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        """Emit the dragged range."""
        dragged, self._fixed_end, self._dragged = self._dragged, None, None
        if dragged is not None and dragged[0] < dragged[1]:
            self.range_dragged.emit(dragged)
        self.update()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        """Play all frames again."""
        if event.position().y() < RULER:
            self._state.set_range(None)

    def event(self, event: QEvent) -> bool:
        """Show the tool tip of the frame under the mouse."""
        if event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            QToolTip.showText(event.globalPos(), self.tip(self.frame_at(event.pos().x())), self)
            return True
        return super().event(event)

    def tip(self, frame: int) -> str:
        facts = self._state.facts
        time_text = self._state.units.time.text(float(facts.times_s[frame]))
        parts = [
            f"frame {frame} · {time_text}",
            CONTACT_TEXTS[int(self._state.history.contact[frame])],
        ]
        parts += [
            f"{count_of(g.missing, 'frame')} missing after this one"
            for g in facts.gaps
            if g.after_frame == frame
        ]
        if frame in self._state.markers:
            notes = [text for at, text in facts.marks if at == frame]
            parts.append(": ".join(["marked", *filter(None, ["; ".join(notes)])]))
        help_text = "Click or drag: seek. Drag in the upper band (or with Shift): range to play"
        return f"{' · '.join(parts)}\n{help_text}; double-click there: play all"

    # -- painting -----------------------------------------------------------------------------

    def paintEvent(self, event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.fillRect(QRectF(MARGIN, RULER, self._span, BAND), QColor(theme.of(self).field))
        self._paint_contact(painter)
        self._paint_ticks(painter)
        self._paint_times(painter)
        self._paint_gaps(painter, self._state.facts.gaps)
        self._paint_range(painter)
        self._paint_markers(painter)
        self._paint_cursor(painter)
        painter.end()

    def _paint_contact(self, painter: QPainter) -> None:
        known = columns(self._state.history.contact, self._axis, int(self._span))
        ends = np.flatnonzero(np.diff(known)) + 1
        colours = {FREE: theme.of(self).free, CONTACT: theme.CONTACT, UNTRUSTED: theme.UNTRUSTED}
        for start, stop in zip([0, *ends], [*ends, len(known)], strict=True):
            if known[start] != UNKNOWN:
                place = QRectF(MARGIN + float(start), RULER, float(stop - start), BAND)
                painter.fillRect(place, QColor(colours[int(known[start])]))

    def _paint_ticks(self, painter: QPainter) -> None:
        step = 1
        while step * self._axis.step * self._span < TICK_PIXELS:
            step *= 10
        bottom = float(RULER + BAND)
        lines = [
            QLineF(x, bottom - (5 if k % 10 else 9), x, bottom)
            for k, x in enumerate(MARGIN + self._axis.places[::step] * self._span)
        ]
        painter.setPen(QPen(QColor(theme.of(self).dim), 1))
        painter.drawLines(lines)

    def _paint_times(self, painter: QPainter) -> None:
        span_s = self._axis.span_s
        most = max(self._span / LABEL_PIXELS, 1)
        longer = (STEPS_S[-1] * 10.0**k for k in count(1))  # for wrong time stamps
        step = next(s for s in chain(STEPS_S, longer) if span_s / s <= most)
        painter.setPen(QColor(theme.of(self).dim))
        font = painter.font()
        font.setPointSizeF(0.8 * font.pointSizeF())
        painter.setFont(font)
        end = -1e9
        for at_s in np.arange(0.0, span_s + 1e-9, step):
            text, x = f"{at_s:g} s", MARGIN + at_s / (span_s or 1.0) * self._span
            width = painter.fontMetrics().horizontalAdvance(text)
            left = min(x + 3, self.width() - width - 2)
            if left > end + 6:
                painter.drawLine(QLineF(x, RULER - 4, x, RULER))
                painter.drawText(QPointF(left, RULER - 4), text)
                end = left + width

    def _paint_gaps(self, painter: QPainter, gaps: tuple[Gap, ...]) -> None:
        field, hatched = QColor(theme.of(self).field), Qt.BrushStyle.BDiagPattern
        for gap in gaps:
            left, right = self.x_at(gap.after_frame), self.x_at(gap.after_frame + 1)
            wide = max(right - left - self._axis.step * self._span, 2.0)
            place = QRectF(0.5 * (left + right - wide), RULER, wide, BAND)
            painter.fillRect(place, field)
            style = hatched if wide > HATCHED_FROM else Qt.BrushStyle.SolidPattern
            painter.fillRect(place, QBrush(QColor(theme.GAP), style))

    def _paint_range(self, painter: QPainter) -> None:
        frames = self._dragged or self._state.play_range
        if frames is None:
            return
        left, right = self.x_at(frames[0]), self.x_at(frames[1])
        accent = QColor(theme.of(self).accent)
        shade = QColor(accent)
        shade.setAlpha(90 if self._state.settings.loop else 45)
        painter.fillRect(QRectF(left, 0, right - left, RULER), shade)
        for x in (left, right):
            painter.fillRect(QRectF(x - 1, 0, 2, RULER + BAND), accent)

    def _paint_markers(self, painter: QPainter) -> None:
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(QColor(theme.of(self).marker))
        for frame in self._state.markers:
            x, top = self.x_at(frame), RULER - 8.0
            corners = [QPointF(x - 5, top), QPointF(x + 5, top), QPointF(x, RULER + 2.0)]
            painter.drawPolygon(QPolygonF(corners))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing, False)

    def _paint_cursor(self, painter: QPainter) -> None:
        if self._state.frozen:
            now = self.x_at(self._state.live_frame)
            painter.fillRect(QRectF(now - 1, RULER, 2, BAND), QColor(theme.FORCE))
        x = self.x_at(self._state.playhead)
        painter.fillRect(QRectF(x - 1, RULER - 4, 2, BAND + 4), QColor(theme.of(self).text))
        if self.hasFocus():
            painter.setPen(QPen(QColor(theme.of(self).accent), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRect(QRectF(MARGIN - 1, RULER, self._span + 1, BAND - 1))

    # -- geometry -----------------------------------------------------------------------------

    @property
    def _axis(self) -> TimeAxis:
        return self._state.facts.axis

    @property
    def _span(self) -> float:
        return float(max(self.width() - 2 * MARGIN, 1))

    def _other_end(self, x: float) -> int | None:
        """The end of the range opposite to the one near `x`; None if none is near."""
        frames = self._state.play_range
        if frames is None:
            return None
        for end, other in (frames, frames[::-1]):
            if abs(self.x_at(end) - x) <= GRAB_RADIUS:
                return other
        return None


def columns(contact: np.ndarray, axis: TimeAxis, width: int) -> np.ndarray:
    """Highest contact state (width,) of the frames (F,) in each screen column.

    Unknown further than a usual step from any frame: in gaps, and where no live frame was solved.
    """
    places = np.linspace(0.0, 1.0, width)
    frames = axis.nearest(places)
    known = np.maximum.reduceat(contact, frames)
    away = np.abs(axis.places[frames] - places) > max(axis.step, 1.0 / width)
    return np.where(away, np.int8(UNKNOWN), known)
