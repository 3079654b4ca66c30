"""Step 5: inflation levels and open chamber, for rectification, λ and gauge pressure."""

from __future__ import annotations

import numpy as np
from PySide6.QtWidgets import QHBoxLayout, QLabel

from bubbleviz.calibration import Identification
from bubbleviz_ui.calibration.calibration_page import ImageView, NumberForm, Page
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.engine.source import RECORDINGS
from bubbleviz_ui.model.units import DASH, Units
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.file_dialogs import file_to_open


class RectificationPage(Page):
    """Residual of the last frame before and after rectification; further inflation levels."""

    name = "Levels"
    title = "Rectification"
    task = "Add recordings of the untouched sensor at other inflation levels, if you have any."
    sets = ("levels", "vented")
    next_title = "Compute the rectification"

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.before, self.after = ImageView("around zero"), ImageView("around zero")
        self.levels = QLabel(wordWrap=True)
        self.add = push_button(
            "Add a level…",
            "Recording of the untouched sensor at another inflation level",
            self._add_level,
        )
        self.drop = push_button(
            "Remove the last",
            "Remove the level added last",
            lambda: calibration.edit("Remove a level", levels=calibration.settings.levels[:-1]),
        )
        self.vented = push_button(
            "Open chamber…",
            "Recording with the chamber open to the air, to measure the atmospheric pressure",
            self._choose_vented,
        )
        self.numbers = NumberForm()
        row = fill(QHBoxLayout(), self.add, self.drop)
        # controls first: a small screen shows no more without scrolling
        fill(self.column, self.levels, row, self.vented, self.before, self.after, self.numbers, 1)

    def is_done(self, answer: Answer) -> bool:
        return bool(answer.work.settings.levels or answer.work.settings.vented)

    def show_answer(self, answer: Answer) -> None:
        unit, last = self.units.fine_length, answer.last
        before, after = (None, None) if last is None else last
        limit = 3.0 * float(np.nanstd(before)) if before is not None else 1.0
        for view, title, image in (
            (self.before, "Last frame, not rectified", before),
            (self.after, "Last frame, rectified", after),
        ):
            view.show_image(title, image, unit, -limit, limit)
        images = {"rms, not rectified": before, "rms, rectified": after}
        settings = self.calibration.settings
        levels, vented = settings.levels, settings.vented
        self.drop.setEnabled(bool(levels))
        names = ", ".join(path.name for path in levels)
        text = (
            f"Further levels: {names}" if levels else "No further levels: an offset for each pixel."
        )
        self.levels.setText(text if vented is None else f"{text}\nOpen chamber: {vented.name}")
        self.numbers.write(
            {
                name: DASH if image is None else unit.text(float(np.sqrt(np.nanmean(image**2))))
                for name, image in images.items()
            }
            | (self._numbers(answer.found) if answer.found.complete else {})
        )

    def _numbers(self, found: Identification) -> dict[str, str]:
        """Rectification, λ and gauge pressure, or why they are not determined."""
        line, gauge, stretch = found.pixels.line, found.gauge, found.prestretch
        fitted, valid = "offset only", DASH
        if line is not None:
            slope, spread, span = line.typical(found.pixels.mask)
            fitted = f"slope of true over measured range {slope:.4f}, σ between pixels {spread:.4f}"
            fitted += f", {line.levels} levels"
            valid = f"{self.units.length.text(span)}; outside, the nearest level's offset"
        text = f"not determined: {found.why_not}"
        if stretch is not None:
            text = "{}, 95 % interval {} … {}".format(*stretch.texts(3))
        return {
            "line": fitted,
            "valid over": valid,
            "λ": text,
            "gauge pressure": self.units.gas_pressure.with_interval(gauge.value, gauge.half_width),
            "gauge pressure from": gauge.source,
        }

    def _choose_vented(self) -> None:
        path = file_to_open(self, "Recording of the open chamber", RECORDINGS, of="recording")
        if path is not None:
            self.calibration.edit(f"Choose the open-chamber recording {path.name}", vented=path)

    def _add_level(self) -> None:
        path = file_to_open(self, "Add an inflation level", RECORDINGS, of="recording")
        if path is not None:
            levels = (*self.calibration.settings.levels, path)
            self.calibration.edit(f"Add the level {path.name}", levels=levels)
