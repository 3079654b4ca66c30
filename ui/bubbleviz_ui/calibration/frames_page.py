"""Step 1: contact-free frames, found automatically, corrected, or collected live."""

from __future__ import annotations

import numpy as np
from PySide6.QtWidgets import QHBoxLayout, QLabel, QSpinBox

from bubbleviz.calibration import Ranges, Step, as_ranges, frame_numbers
from bubbleviz.recordings import SIGNIFICANT, ContactFree, TimeAxis
from bubbleviz_ui.calibration.calibration_page import Page
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.calibration.collect_box import CollectBox
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.panels.plot_host import LEFT, RIGHT, Part, Plot, PlotHost
from bubbleviz_ui.playback.range_strip import MARGIN, RangeStrip
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, push_button

# Deviation of each frame from rest, which shows why a range ends where it does.


HEIGHT = 120
COLOURS = theme.BLUE, theme.ORANGE  # Of depth, and of gas pressure
LOWEST, LEAST_TOP, MOST = 0.1, 200.0, 1e4
"""Lower end of the logarithmic axis, smallest and largest upper end, standard deviations."""


class ScorePlot(PlotHost):
    """Deviation from rest in standard deviations, on a logarithmic axis, aligned with the strip."""

    def __init__(self) -> None:
        super().__init__(self._make)
        self.setFixedHeight(HEIGHT)
        self.setToolTip(
            "Change from rest, in standard deviations, of the gas pressure and of the 1 % of the "
            f"depth image that changed most. Above the line ({SIGNIFICANT:g} σ) for several "
            "frames: contact"
        )
        self._found: ContactFree | None = None
        self.seen.connect(self._draw)

    def show_scores(self, found: ContactFree | None, axis: TimeAxis) -> None:
        """Show the scores of a search for contact-free frames; None hides the plot."""
        self._found, self._axis = found, axis
        self.setVisible(found is not None)
        self._draw()

    def _make(self) -> list[Part]:
        self.drawn = Plot("nothing", left="logarithm")
        self.curves = [self.drawn.add_curve(colour) for colour in COLOURS]
        self.drawn.add_line(angle=0, pos=np.log10(SIGNIFICANT))
        self.arrange([self.drawn.item])
        return [self.drawn]

    def _draw(self) -> None:
        if not self.ready or self._found is None:
            return
        highest, words = LEAST_TOP, ["change from rest (σ):"]
        scores = ("depth", self._found.depth_score), ("gas pressure", self._found.pressure_score)
        for curve, colour, (name, score) in zip(self.curves, COLOURS, scores, strict=True):
            curve.clear()
            if score is not None:
                curve.setData(self._axis.places, np.log10(np.clip(score, LOWEST, MOST)))
                highest = max(highest, min(float(score.max()), MOST))
                words.append(f'<span style="color:{colour}">{name}</span>')
        ends = np.log10([LOWEST, highest])
        self.drawn.box.setRange(xRange=(0.0, 1.0), yRange=ends, padding=0.0)
        self.drawn.write(" ".join(words))


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
        self.collect = CollectBox(calibration)
        # the same time axis in both
        strip = fill(QHBoxLayout(), self.strip, margins=(LEFT - MARGIN, 0, 0, 0))
        plot = fill(QHBoxLayout(), self.plot, margins=(0, 0, MARGIN - RIGHT, 0))
        fill(self.column, strip, plot, self.message)
        numbers = (QLabel("frames"), self.first, QLabel("to"), self.last, 1)
        buttons = (self.add, self.remove, self.replace, self.find_again, 1)
        rows = [fill(QHBoxLayout(), *row) for row in (numbers, buttons)]
        fill(self.column, *rows, self.collect, 1)
        self.strip.edited.connect(self.set_ranges)

    def set_ranges(self, ranges: Ranges | None, what: str) -> None:
        """Use these ranges, or search them; `what`: the change, for undo."""
        reached = max(self.calibration.settings.last_step, Step.FRAMES)
        self.calibration.edit(what, ranges=ranges, last_step=reached)

    def show_answer(self, answer: Answer) -> None:
        ranges, before = answer.found.ranges, self.strip.ranges
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
            self.message.setText("Collect frames below." if live else "")
            return
        found = answer.found.contact_free
        words = ", ".join(f"{a}–{b - 1}" if b - a > 1 else f"{a}" for a, b in ranges) or "none"
        text = f"frames {words}: {count} of {answer.frames}"
        if found is not None and answer.work.settings.ranges is None:
            text += f" – found automatically; {ENDED_BY[found.ended_by]}"
        self.message.setText(text)

    @property
    def _chosen(self) -> range:
        return range(self.first.value(), self.last.value() + 1)

    def _on_add(self) -> None:
        present = frame_numbers(self.calibration.answer.found.ranges)
        self.set_ranges(as_ranges([*present, *self._chosen]), "Add frames")

    def _on_replace(self) -> None:
        self.set_ranges(as_ranges(self._chosen), "Replace frames")

    def _on_remove(self) -> None:
        present = frame_numbers(self.calibration.answer.found.ranges)
        removed = f"Remove frames {self.first.value()}–{self.last.value()}"
        self.set_ranges(as_ranges({*present} - {*self._chosen}), removed)
