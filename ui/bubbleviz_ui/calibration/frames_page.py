"""Step 1: contact-free frames, found automatically, corrected, or collected live."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSpinBox, QWidget

from bubbleviz.calibration import Ranges, Step, as_ranges, frame_numbers
from bubbleviz.recordings import SIGNIFICANT, ContactFree, TimeAxis
from bubbleviz_ui.calibration.calibration_page import Page
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.calibration.collect_box import CollectBox
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.playback.range_strip import MARGIN, RangeStrip
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, push_button

# Deviation of each frame from rest, which shows why a range ends where it does.


HEIGHT = 120
LOWEST, LEAST_TOP, MOST = 0.1, 200.0, 1e4
"""Lower end of the logarithmic axis, smallest and largest upper end, standard deviations."""
COLOURS = {"depth": theme.BLUE, "gas pressure": theme.FARTHER}


class ScorePlot(QWidget):
    """Deviation from rest in standard deviations, on a logarithmic axis, aligned with the strip.

    Painted directly, as a pyqtgraph plot would keep its window alive through its menus.
    """

    def __init__(self) -> None:
        super().__init__()
        self.setFixedHeight(HEIGHT)
        self.setToolTip(
            "Change from rest, in standard deviations, of the gas pressure and of the 1 % of the "
            f"depth image that changed most. Above the dashed line ({SIGNIFICANT:g} σ) for several "
            "frames: contact"
        )
        self._scores: dict[str, np.ndarray] = {}
        self._axis = TimeAxis(np.zeros(0))

    def show_scores(self, found: ContactFree | None, axis: TimeAxis) -> None:
        """Show the scores of a search for contact-free frames; None hides the plot."""
        self.setVisible(found is not None)
        self._scores, self._axis = {}, axis
        if found is not None:
            both = {"depth": found.depth_score, "gas pressure": found.pressure_score}
            self._scores = {name: each for name, each in both.items() if each is not None}
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw curves, threshold and axis labels."""
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


ENDED_BY = {
    "depth": "the depth image changes after them",
    "pressure": "the gas pressure changes after them",
    "recording": "no change until the end: make sure that nothing touched the sensor",
}


class FramesPage(Page):
    """Strip of ranges, plot of the deviation from rest, boxes for frame numbers."""

    name = "Frames"
    title = "Contact-free frames"
    task = (
        "Find or collect frames in which nothing touches the membrane; drag the ranges to correct "
        "them."
    )
    sets = ("ranges",)
    next_title = "Find contact-free frames"
    step = Step.FRAMES

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.plot = ScorePlot()
        self.strip = RangeStrip()
        self.message = QLabel(wordWrap=True)
        self.first, self.last = QSpinBox(), QSpinBox()
        self.first.setToolTip("First frame of the range for Add, Remove and Replace")
        self.last.setToolTip("Last frame of the range for Add, Remove and Replace")
        self.add = push_button(
            "Add", "Add the frames of this range to the contact-free ones", self._on_add
        )
        self.remove = push_button(
            "Remove", "Remove the frames of this range from the contact-free ones", self._on_remove
        )
        self.replace = push_button(
            "Replace", "Use only the frames of this range as contact-free ones", self._on_replace
        )
        self.find_again = push_button(
            "Find again",
            "Discard the ranges and search contact-free frames again",
            lambda: self.set_ranges(None, "Find contact-free frames"),
        )
        self.collect = CollectBox(calibration, units)
        self._lay_out()
        self.strip.edited.connect(self.set_ranges)

    def set_ranges(self, ranges: Ranges | None, what: str) -> None:
        """Use these ranges, or search them; `what`: the change, for undo."""
        reached = max(self.calibration.settings.last_step, Step.FRAMES)
        self.calibration.edit(what, ranges=ranges, last_step=reached)

    def show_answer(self, answer: Answer) -> None:
        ranges, before = self.ranges(answer), self.strip.ranges
        self.strip.set_ranges(answer.axis, ranges)
        self.plot.show_scores(answer.found.contact_free, answer.axis)
        for box in (self.first, self.last):
            box.setMaximum(max(answer.frames - 1, 0))
        if ranges and ranges != before:  # else keep what was typed
            self.first.setValue(ranges[0][0])
            self.last.setValue(ranges[0][1] - 1)
        count = len(frame_numbers(ranges))
        live = self.calibration.live
        for widget in (self.find_again, self.add, self.remove, self.replace):
            widget.setEnabled(answer.frames > 0)
        self.collect.setVisible(live)
        if not answer.frames:
            self.message.setText("Collect frames of the live source." if live else "")
            return
        found = answer.found.contact_free
        words = ", ".join(f"{a}–{b - 1}" if b - a > 1 else f"{a}" for a, b in ranges) or "none"
        text = f"frames {words}: {count} of {answer.frames}"
        if found is not None and answer.work.settings.ranges is None:
            text += f" – found automatically; {ENDED_BY[found.ended_by]}"
        self.message.setText(text)

    @staticmethod
    def ranges(answer: Answer) -> Ranges:
        return answer.found.ranges

    @property
    def _chosen(self) -> range:
        return range(self.first.value(), self.last.value() + 1)

    def _on_add(self) -> None:
        present = frame_numbers(self.ranges(self.calibration.answer))
        self.set_ranges(as_ranges([*present, *self._chosen]), "Add frames")

    def _on_replace(self) -> None:
        self.set_ranges(as_ranges(self._chosen), "Replace frames")

    def _on_remove(self) -> None:
        present = frame_numbers(self.ranges(self.calibration.answer))
        removed = f"Remove frames {self.first.value()}–{self.last.value()}"
        self.set_ranges(as_ranges({*present} - {*self._chosen}), removed)

    def _lay_out(self) -> None:
        fill(self.column, self.strip, self.plot, self.message)
        numbers = (QLabel("frames"), self.first, QLabel("to"), self.last, 1)
        buttons = (self.add, self.remove, self.replace, self.find_again, 1)
        rows = [fill(QHBoxLayout(), *row) for row in (numbers, buttons)]
        fill(self.column, *rows, self.collect, 1)
