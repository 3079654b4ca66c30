"""How far each frame is from rest, over the strip of ranges: why a range ends where it does."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QWidget

from bubbleviz.calibration.rest.contact_free import SIGNIFICANT, ContactFree
from bubbleviz.frames.gaps import TimeAxis
from bubbleviz_ui.playback.range_strip import MARGIN
from bubbleviz_ui.shell import theme

HEIGHT = 120
LOWEST, LEAST_TOP, MOST = 0.1, 200.0, 1e4
"""Standard deviations at the bottom of the logarithmic axis; at its top, at least and at most."""
COLOURS = {"depth": theme.BLUE, "gas pressure": theme.FARTHER}


class ScorePlot(QWidget):
    """Standard deviations from rest, logarithmic, as wide as the strip below it.

    Drawn by hand: a pyqtgraph plot keeps its window alive through its menus.
    """

    def __init__(self) -> None:
        super().__init__()
        self.setFixedHeight(HEIGHT)
        self.setToolTip(
            "Standard deviations from rest of the most changed 1 % of the view and of the gas"
            f" pressure; dashed: {SIGNIFICANT:g} σ, beyond which it is contact"
        )
        self._scores: dict[str, np.ndarray] = {}
        self._axis = TimeAxis(np.zeros(0))

    def show_scores(self, found: ContactFree | None, axis: TimeAxis) -> None:
        """Show the scores of a search of frames on an axis; None: nothing."""
        self.setVisible(found is not None)
        self._scores, self._axis = {}, axis
        if found is not None:
            both = {"depth": found.depth_score, "gas pressure": found.pressure_score}
            self._scores = {name: each for name, each in both.items() if each is not None}
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Lines, the threshold, and decades at the left."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        colours = theme.of(self)
        painter.fillRect(self.rect(), QColor(colours.view))
        peaks = [float(each.max()) for each in self._scores.values()]
        highest = min(max([LEAST_TOP, *peaks]), MOST)
        painter.setPen(QColor(colours.dim))
        for decade in (1.0, 10.0, 100.0):
            y = self._y(decade, highest)
            painter.drawText(QPointF(MARGIN + 14, y + 4), f"{decade:g} σ")
            painter.drawLine(QPointF(MARGIN, y), QPointF(MARGIN + 10, y))
        painter.setPen(QPen(QColor(colours.dim), 1.0, Qt.PenStyle.DashLine))
        level = self._y(SIGNIFICANT, highest)
        painter.drawLine(QPointF(MARGIN, level), QPointF(self.width() - MARGIN, level))
        for number, (name, score) in enumerate(self._scores.items()):
            painter.setPen(QColor(COLOURS[name]))
            painter.drawText(QPointF(MARGIN + 70 + 60 * number, 16), name)
            wide = self.width() - 2 * MARGIN
            points = [
                QPointF(MARGIN + place * wide, self._y(float(value), highest))
                for place, value in zip(self._axis.places, score, strict=True)
            ]
            painter.drawPolyline(QPolygonF(points))
        painter.end()

    def _y(self, score: float, highest: float) -> float:
        share = np.log10(min(max(score, LOWEST), highest) / LOWEST) / np.log10(highest / LOWEST)
        return 4.0 + (self.height() - 8.0) * (1.0 - float(share))
