"""Step 2: which pixels to trust; the thresholds move the mask at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import QComboBox, QDoubleSpinBox, QFormLayout, QHBoxLayout, QSlider

from bubbleviz.calibration.draft import Step
from bubbleviz.wording import count_of
from bubbleviz_ui.calibration.calibration_answer import Answer
from bubbleviz_ui.calibration.calibration_page import Numbers, Page
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.calibration.image_view import ImageView
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shell.layouts import fill

PICTURES = ("Pixels used", "Noise σ", "Validity")
USED = Unit("", 1.0, 0)
MOST_DEVIATIONS = 20.0  # σ, end of the scale


class PixelsPage(Page):
    """Mask, noise and validity as images; thresholds on validity and σ."""

    name = "Pixels"
    title = "Pixel mask"
    todo = "Check which pixels are used; move the thresholds where good ones are left out."
    sets = ("min_validity", "deviations")
    next_title = "Measure the pixels"

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.picture = QComboBox()
        self.picture.addItems(PICTURES)
        self.picture.setToolTip("What the image shows of each pixel")
        self.view = ImageView()
        self.validity = Threshold(units.share, 1.0, "automatic")
        self.deviations = Threshold(Unit("σ", 1.0, 1), MOST_DEVIATIONS)
        self.validity.tip("Share of the frames in which a pixel must have a return")
        self.deviations.tip("Beyond so many robust deviations a pixel is too noisy or too far off")
        self.numbers = Numbers()
        form = QFormLayout()
        form.addRow("Picture", self.picture)
        form.addRow("Minimum validity", self.validity)
        form.addRow("Maximum deviation", self.deviations)
        fill(self.column, self.view, form, self.numbers, 1)
        self.picture.currentIndexChanged.connect(lambda _: self._show_picture(calibration.answer))
        self.validity.changed = lambda v, gesture: calibration.edit(
            "Validity threshold", gesture, min_validity=v or None
        )
        self.deviations.changed = lambda v, gesture: calibration.edit(
            "Deviation threshold", gesture, deviations=max(v, 0.1)
        )

    def enter(self) -> None:
        """Measure every pixel."""
        self.calibration.reach(Step.PIXELS, self.next_title)

    def is_done(self, answer: Answer) -> bool:
        """Whether the pixels are measured."""
        return answer.work.settings.reached >= Step.PIXELS

    def show_answer(self, answer: Answer) -> None:
        """Show the mask and its counts."""
        settings, samples, pixels = (
            self.calibration.settings,
            answer.draft.samples,
            answer.draft.pixels,
        )
        self.validity.show_value(settings.min_validity or 0.0)
        self.deviations.show_value(settings.deviations)
        self._show_picture(answer)
        if samples is None or pixels is None:
            return
        statistics, units = samples.statistics, self.units
        used = int(pixels.mask.sum())
        self.numbers.set("used", f"{used} of {pixels.mask.size} pixels")
        noise = float(np.median(pixels.noise_m[pixels.mask])) if used else None
        self.numbers.set("noise of a pixel", units.fine_length.text(noise))
        for reason, count in pixels.removed.items():
            self.numbers.set(reason.replace("_", " "), count_of(count, "pixel"))
        self.numbers.set("one independent sample", f"{statistics.correlated_pixels:.1f} pixels")
        self.numbers.set(
            "frames", f"{statistics.effective_frames:.1f} effective frames of {statistics.frames}"
        )

    def _show_picture(self, answer: Answer) -> None:
        samples, pixels = answer.draft.samples, answer.draft.pixels
        which = self.picture.currentText()
        if samples is None or pixels is None:
            self.view.show_image(which, None, USED, 0.0, 1.0)
        elif which == PICTURES[0]:
            self.view.show_image("Pixels used: bright", pixels.mask.astype(float), USED, 0.0, 1.0)
        elif which == PICTURES[1]:
            noise = samples.statistics.noise_m.astype(float)
            mask = pixels.mask if pixels.mask.any() else np.isfinite(noise)
            top = float(np.nanpercentile(noise[mask], 99.0))
            title = "Standard deviation of one frame's range"
            self.view.show_image(title, noise, self.units.fine_length, 0.0, top)
        else:
            validity = samples.statistics.validity.astype(float)
            title = "Share of the frames with a return"
            self.view.show_image(title, validity, self.units.share, 0.0, 1.0)


class Threshold(QHBoxLayout):
    """Slider and box for one number; a drag of the slider is one gesture."""

    STEPS = 200

    def __init__(self, unit: Unit, highest_si: float, lowest_means: str = "") -> None:
        super().__init__()
        self._unit, self._highest = unit, highest_si
        self._gestures = 0
        self.changed: Callable[[float, object], None] = lambda value, gesture: None
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, self.STEPS)
        self.box = QDoubleSpinBox()
        self.box.setRange(0.0, unit.of(highest_si))
        self.box.setDecimals(unit.digits)
        self.box.setSuffix(f" {unit.symbol}")
        self.box.setKeyboardTracking(False)
        self.box.setSpecialValueText(lowest_means)
        self.addWidget(self.slider, 1)
        self.addWidget(self.box)
        self.slider.sliderPressed.connect(self._begin)
        self.slider.valueChanged.connect(self._on_slider)
        self.box.valueChanged.connect(self._on_box)

    def tip(self, text: str) -> None:
        """Say what it is for."""
        self.slider.setToolTip(text)
        self.box.setToolTip(text)

    def show_value(self, value_si: float) -> None:
        """Show a value that was chosen elsewhere."""
        with QSignalBlocker(self.slider), QSignalBlocker(self.box):
            if not self.slider.isSliderDown():
                self.slider.setValue(round(value_si / self._highest * self.STEPS))
            self.box.setValue(self._unit.of(value_si))

    def _begin(self) -> None:
        self._gestures += 1

    def _on_slider(self, place: int) -> None:
        gesture = (id(self), self._gestures) if self.slider.isSliderDown() else None
        self.changed(place / self.STEPS * self._highest, gesture)

    def _on_box(self, shown: float) -> None:
        self.changed(self._unit.to_si(shown), None)
