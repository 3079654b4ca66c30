"""Step 6: a known object at a known pose, predicted and compared with the measured cloud."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QSpinBox,
)

from bubbleviz.calibration.draft import Step
from bubbleviz.files.preset_files import presets_folder
from bubbleviz_ui.calibration.calibration_answer import Answer
from bubbleviz_ui.calibration.calibration_page import Numbers, Page
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.calibration.image_view import ImageView
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell.layouts import fill

if TYPE_CHECKING:
    from bubbleviz.calibration.validation import Validation


class ValidationPage(Page):
    """Object, pose and frames of a press; distances of the cloud from the prediction.

    Attributes
    ----------
    painted : Signal
        Points (k, 3) in m and their signed distances in m, for the 3-D view.
    """

    name = "Press"
    title = "Validation"
    todo = "Say which object was pressed where, and compare, if you know it."
    sets = ("press",)
    next_title = "Validate by a known press"
    painted = Signal(object, object)

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.view = ImageView("around zero")
        self.obj = QComboBox()
        self.obj.setEditable(True)
        self.obj.addItems(sorted(p.stem for p in presets_folder("objects").glob("*.*")))
        self.pose = QLineEdit("0 0 0.05 0 0 0 1")
        self.first, self.last = QSpinBox(), QSpinBox()
        self.predict = QPushButton("Predict and compare")
        self.remove = QPushButton("Remove")
        self.paint = QPushButton("Paint the distances in the 3-D view")
        self.obj.setToolTip("Object that was pressed: a preset or a mesh file")
        self.first.setToolTip("First pressed frame")
        self.last.setToolTip("Last pressed frame")
        self.predict.setToolTip(
            "Shape that the forward model predicts (Eq. 16), beside the measured"
        )
        self.remove.setToolTip("Remove the validation by this press")
        self.paint.setToolTip("Measured minus predicted range at the points of the membrane")
        self.numbers = Numbers()
        self._lay_out()
        self.predict.clicked.connect(self._on_predict)
        self.remove.clicked.connect(lambda: calibration.edit("Remove the validation", press=None))
        self.paint.clicked.connect(self._paint)

    def is_done(self, answer: Answer) -> bool:
        """Whether a press was compared."""
        return answer.draft.validation is not None

    def show_answer(self, answer: Answer) -> None:
        """Show what was chosen and what came of it."""
        units, press = self.units, self.calibration.settings.press
        for box in (self.first, self.last):
            box.setMaximum(max(answer.frames - 1, 0))
        if press is not None:
            with QSignalBlocker(self.obj):
                self.obj.setCurrentText(press.obj)
            self.pose.setText(press.pose)
            self.first.setValue(press.first)
            self.last.setValue(press.stop - 1)
        ready = answer.draft.found is not None and not self.calibration.busy
        self.predict.setEnabled(ready)
        self.remove.setEnabled(press is not None)
        found = answer.draft.validation
        self.paint.setEnabled(found is not None)
        self.numbers.setVisible(found is not None)
        image = found.distance_image_m if found is not None else None
        limit = 3.0 * found.rms_m if found is not None else 1e-3
        title = "Cloud's distance from the predicted membrane"
        self.view.show_image(title, image, units.fine_length, -limit, limit)
        self._show_numbers(found)

    def _show_numbers(self, found: Validation | None) -> None:
        say, length, force = self.numbers.set, self.units.fine_length, self.units.force
        if found is None:
            return
        say("distance, rms", length.text(found.rms_m))
        say("95 % within", length.text(found.p95_m))
        say("from no contact, rms", length.text(found.untouched_rms_m))
        say("overlap of the patches", self.units.share.text(found.patch_overlap))
        say("force predicted", force.text(float(np.linalg.norm(found.predicted_force_n))))
        say("force estimated", force.text(float(np.linalg.norm(found.measured_force_n))))

    def _on_predict(self) -> None:
        from bubbleviz.calibration.validation import KnownPress  # the window starts without

        press = KnownPress(
            self.obj.currentText().strip(),
            self.pose.text().strip(),
            self.first.value(),
            self.last.value() + 1,
        )
        self.calibration.edit("Validate by a known press", press=press, reached=Step.TENSION)

    def _paint(self) -> None:
        found = self.calibration.answer.draft.validation
        if found is not None:
            self.painted.emit(found.points_m, found.distance_m)

    def _lay_out(self) -> None:
        self.column.addWidget(self.view)
        form = QFormLayout()
        form.addRow("Object", self.obj)
        form.addRow("Pose", self.pose)
        frames = fill(QHBoxLayout(), self.first, QLabel("to"), self.last, 1)
        form.addRow("Frames", frames)
        self.column.addLayout(form)
        buttons = fill(QHBoxLayout(), self.predict, self.remove)
        fill(self.column, buttons, self.numbers, self.paint, 1)
        self.pose.setToolTip("T_B_O: x y z qx qy qz qw in m; origin in the middle of the rim plane")
