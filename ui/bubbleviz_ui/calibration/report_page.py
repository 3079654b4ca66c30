"""Steps 6 and 7: validation by a known press; report, comparison, and saving."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QLineEdit, QSpinBox

from bubbleviz.calibration import Step, advice, parameters, sentence
from bubbleviz.files import presets_folder
from bubbleviz_ui.calibration.calibration_page import ImageView, NumberForm, Page
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.calibration.levels_page import RectificationPage
from bubbleviz_ui.calibration.pixels_page import SurfacePage
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.binding import form
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.table import Table

if TYPE_CHECKING:
    from bubbleviz.calibration import QuantityKind, SensorComparison
    from bubbleviz.simulation import Validation


_PAGES = {"--vented": RectificationPage, "--level": RectificationPage, "--nodes": SurfacePage}
"""Page of the panel in place of each option of the command."""


class ReportPage(Page):
    """Verdict, comparison with the sensor in use before, and saving."""

    name = "Report"
    title = "Report"
    task = "Compare with the sensor used before, then save the new one, or use it now."
    next_title = "Compare and save"

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.advice = QLabel(wordWrap=True)
        self.advice.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.compared = QLabel(wordWrap=True)
        self.table = Table(("", "before", "new"))
        self.view = ImageView("around zero")
        self._lay_out()

    def is_done(self, answer: Answer) -> bool:
        return self.calibration.saved == answer.work

    def show_answer(self, answer: Answer) -> None:
        found, comparison = answer.found, answer.comparison
        lines: list[str] = []
        if found.complete:
            pressure = self.units.gas_pressure.text
            lines = [*advice(found, pressure), *map(_remark, parameters(found, pressure))]
        text = "\n".join(f"• {line}" for line in lines)
        for option, page in _PAGES.items():
            text = re.sub(rf"{option}(?![\w-])", f"step {page.name}", text)
        self.advice.setText(text)
        old = answer.compared_with
        self.compared.setText(f"Before: {old.name}" if old is not None else "")
        self._show_table(comparison)
        length = self.units.fine_length
        difference = comparison.difference_m if comparison is not None else None
        limit = comparison.largest_m if comparison is not None else 1e-3
        self.view.show_image(
            "Expected range of the untouched membrane, new sensor minus the one before",
            difference, length, -limit, limit)  # fmt: skip

    def _show_table(self, comparison: SensorComparison | None) -> None:
        rows = comparison.rows if comparison is not None else ()
        self.table.setRowCount(len(rows))
        for number, row in enumerate(rows):
            unit = self._unit(row.kind)
            old = unit.with_interval(row.old, row.old_half_width)
            new = unit.with_interval(row.new, row.half_width)
            self.table.write(number, (row.name, old.rstrip(), new.rstrip()), right=range(0))
        self.table.setFixedHeight(self.table.full_height)

    def _unit(self, kind: QuantityKind) -> Unit:
        units = self.units
        by_kind: dict[QuantityKind, Unit] = {
            "tension": units.tension,
            "pressure": units.gas_pressure,
            "length": units.length,
            "fine length": units.fine_length,
            "volume": units.volume,
            "area": units.area,
            "count": Unit("pixels", 1.0, 0),
            "number": Unit("", 1.0, 3),
        }
        return by_kind[kind]

    def _lay_out(self) -> None:
        self.table.setToolTip("±: half of the 95 % interval, where it is known")
        self.table.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        fill(self.column, self.compared, self.table, self.view, self.advice, 1)


def _remark(row: dict[str, str]) -> str:
    """A row of `parameters` as a sentence; a value with its interval is in the table."""
    if "95 % interval" in row["value"]:
        return "{name} ({source}). To improve it: {improvement}.".format(**row)
    return sentence(row)


# Step 6: validation by pressing a known object at a known pose.


class ValidationPage(Page):
    """Object, pose and frames of a press; distances of measured points from the prediction."""

    name = "Press"
    title = "Validation"
    task = "If you know which object was pressed and its pose, enter both and compare."
    sets = ("obj", "pose", "pressed")
    next_title = "Validate by a known press"

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.view = ImageView("around zero")
        self.obj = QComboBox()
        self.obj.setEditable(True)
        self.obj.addItems(sorted(p.stem for p in presets_folder("objects").glob("*.*")))
        self.pose = QLineEdit("0 0 0.05 0 0 0 1")
        self.first, self.last = QSpinBox(), QSpinBox()
        self.predict = push_button(
            "Predict and compare",
            "Compare the shape predicted by the forward model (Eq. 16) with the measured one",
            self._on_predict,
        )
        self.remove = push_button(
            "Remove",
            "Remove the validation by this press",
            lambda: calibration.edit("Remove the validation", pressed=None),
        )
        self.obj.setToolTip("Object that was pressed: a preset or a mesh file")
        self.first.setToolTip("First frame in which the object is held still")
        self.last.setToolTip("Last frame in which the object is held still")
        self.numbers = NumberForm()
        self.summary = QLabel(wordWrap=True)
        self._lay_out()

    def is_done(self, answer: Answer) -> bool:
        return answer.found.validation is not None

    def show_answer(self, answer: Answer) -> None:
        units, settings = self.units, self.calibration.settings
        for box in (self.first, self.last):
            box.setMaximum(max(answer.frames - 1, 0))
        if settings.pressed is not None:
            with QSignalBlocker(self.obj):
                self.obj.setCurrentText(settings.obj)
            self.pose.setText(settings.pose)
            self.first.setValue(settings.pressed[0])
            self.last.setValue(settings.pressed[1] - 1)
        ready = answer.found.complete and not self.calibration.busy
        self.predict.setEnabled(ready)
        self.remove.setEnabled(settings.pressed is not None)
        found = answer.found.validation
        for each in (self.view, self.numbers):
            each.setVisible(found is not None)
        image = found.distance_m if found is not None else None
        limit = 3.0 * found.rms_m if found is not None else 1e-3
        title = "Distance of the points from the predicted membrane, positive outside"
        self.view.show_image(title, image, units.fine_length, -limit, limit)
        self._show_numbers(found)

    def _show_numbers(self, found: Validation | None) -> None:
        self.summary.setVisible(found is not None)
        if found is None:
            return
        length, force = self.units.fine_length, self.units.force
        self.summary.setText(found.summary)
        colours = theme.of(self)
        self.summary.setStyleSheet(f"color: {colours.doubtful if found.failures else colours.good}")
        self.numbers.write(
            {
                "distance, rms": length.text(found.rms_m),
                "distance, 95th percentile": length.text(found.p95_m),
                "distance from rest, rms": length.text(found.untouched_rms_m),
                "overlap of the patches": self.units.share.text(found.patch_overlap),
                "force predicted": force.text(float(np.linalg.norm(found.predicted_force_n))),
                "force estimated": force.text(float(np.linalg.norm(found.measured_force_n))),
            }
        )

    def _on_predict(self) -> None:
        self.calibration.edit(
            "Validate by a known press",
            obj=self.obj.currentText().strip(),
            pose=self.pose.text().strip(),
            pressed=(self.first.value(), self.last.value() + 1),
            last_step=Step.TENSION,
        )

    def _lay_out(self) -> None:
        frames = fill(QHBoxLayout(), self.first, QLabel("to"), self.last, 1)
        rows = form(
            ("Object", self.obj), ("Pose: x y z in m,\nqx qy qz qw", self.pose), ("Frames", frames)
        )
        buttons = fill(QHBoxLayout(), self.predict, self.remove)
        fill(self.column, self.view, rows, buttons, self.summary, self.numbers, 1)
        self.pose.setToolTip(
            "T_B_O, the object's pose in B: x y z in m, qx qy qz qw; origin of B: middle of the "
            "rim plane"
        )
