"""Steps 2 to 4: pixel mask, reference surface, tension γ0."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QFormLayout,
    QHBoxLayout,
    QSlider,
    QSpinBox,
)

from bubbleviz.calibration import SURFACE_NAMES, Identification, Step
from bubbleviz.wording import count_of
from bubbleviz_ui.calibration.calibration_page import ImageView, NumberForm, Page
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shell.binding import options
from bubbleviz_ui.shell.dock import fill

PICTURES = ("Pixels used", "Noise σ", "Validity")
USED = Unit("", 1.0, 0)
MOST_DEVIATIONS = 20.0  # σ, end of the scale


class PixelsPage(Page):
    """Mask, noise and validity as images; thresholds on validity and σ."""

    name = "Pixels"
    title = "Pixel mask"
    task = "Check which pixels are used; move the thresholds if good ones are excluded."
    sets = ("min_validity", "deviations")
    next_title = "Measure the pixels"
    step = Step.PIXELS

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.picture = QComboBox()
        self.picture.addItems(PICTURES)
        self.picture.setToolTip("Quantity shown for each pixel")
        self.view = ImageView()
        self.validity = Threshold(
            units.share,
            1.0,
            "Share of the frames in which a pixel must have valid depth to be used; lowest value: "
            "automatic",
            "automatic",
        )
        self.deviations = Threshold(
            Unit("σ", 1.0, 1),
            MOST_DEVIATIONS,
            "Pixels with noise or offset beyond this many robust standard deviations are excluded",
        )
        self.numbers = NumberForm()
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

    def show_answer(self, answer: Answer) -> None:
        settings, found = self.calibration.settings, answer.found
        samples, pixels = found.samples, found.pixels
        self.validity.show_value(settings.min_validity or 0.0)
        self.deviations.show_value(settings.deviations)
        self._show_picture(answer)
        if samples is None or pixels is None:
            self.numbers.clear()
            return
        statistics, units = samples.statistics, self.units
        used = int(pixels.mask.sum())
        self.numbers.set("used", f"{used} of {pixels.mask.size} pixels")
        noise = float(np.median(pixels.noise_m[pixels.mask])) if used else None
        self.numbers.set("noise of a pixel", units.fine_length.text(noise))
        for reason, count in pixels.removed.items():
            self.numbers.set(f"excluded, {reason.replace('_', ' ')}", count_of(count, "pixel"))
        self.numbers.set("one independent sample", f"{statistics.correlated_pixels:.1f} pixels")
        effective = f"{statistics.effective_frames:.1f}"
        self.numbers.set("frames", f"{statistics.frames}, as good as {effective} independent ones")

    def _show_picture(self, answer: Answer) -> None:
        samples, pixels = answer.found.samples, answer.found.pixels
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
            title = "Share of the frames with valid depth"
            self.view.show_image(title, validity, self.units.share, 0.0, 1.0)


class Threshold(QHBoxLayout):
    """Slider and box for one number; a drag of the slider is one undo step."""

    STEPS = 200

    def __init__(self, unit: Unit, highest_si: float, tip: str, lowest_text: str = "") -> None:
        super().__init__()
        self._unit, self._highest = unit, highest_si
        self._drags = 0
        self.changed: Callable[[float, object], None] = lambda value, gesture: None
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, self.STEPS)
        self.box = QDoubleSpinBox(decimals=unit.digits, suffix=f" {unit.symbol}")
        self.box.setRange(0.0, unit.from_si(highest_si))
        self.box.setKeyboardTracking(False)
        self.box.setSpecialValueText(lowest_text)
        for part, stretch in ((self.slider, 1), (self.box, 0)):
            part.setToolTip(tip)
            self.addWidget(part, stretch)
        self.slider.sliderPressed.connect(self._begin_drag)
        self.slider.valueChanged.connect(self._on_slider)
        self.box.valueChanged.connect(lambda shown: self.changed(unit.to_si(shown), None))

    def show_value(self, value_si: float) -> None:
        with QSignalBlocker(self.slider), QSignalBlocker(self.box):
            if not self.slider.isSliderDown():
                self.slider.setValue(round(value_si / self._highest * self.STEPS))
            self.box.setValue(self._unit.from_si(value_si))

    def _begin_drag(self) -> None:
        self._drags += 1

    def _on_slider(self, place: int) -> None:
        gesture = (id(self), self._drags) if self.slider.isSliderDown() else None
        self.changed(place / self.STEPS * self._highest, gesture)


# Step 3: the reference surface, chosen automatically or by the user.


class SurfacePage(Page):
    """Residual to the surface, misfit of each candidate, dimensions."""

    name = "Surface"
    title = "Reference surface"
    task = "Check that the residual looks like noise; otherwise choose another surface."
    sets = ("surface", "nodes")
    next_title = "Fit the surface"
    step = Step.SURFACE

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.view = ImageView("around zero")
        surfaces = {None: "automatic: best fit"} | {name: name for name in SURFACE_NAMES}
        self.choice = options(QComboBox(), surfaces)
        self.nodes = QSpinBox(minimum=30, maximum=20_000, singleStep=100)
        self.nodes.setKeyboardTracking(False)
        self.choice.setToolTip("Shape of the reference surface x0 (Eq. 1)")
        self.nodes.setToolTip("Number of nodes of the surface mesh")
        self.numbers = NumberForm()
        form = QFormLayout()
        form.addRow("Surface", self.choice)
        form.addRow("Nodes of the mesh", self.nodes)
        fill(self.column, self.view, form, self.numbers, 1)
        self.choice.activated.connect(
            lambda row: calibration.edit("Choose the surface", surface=self.choice.itemData(row))
        )
        self.nodes.valueChanged.connect(lambda n: calibration.edit("Nodes of the mesh", nodes=n))

    def show_answer(self, answer: Answer) -> None:
        settings, found = self.calibration.settings, answer.found
        self.choice.setCurrentIndex(self.choice.findData(settings.surface))
        with QSignalBlocker(self.nodes):
            self.nodes.setValue(settings.nodes)
        surfaces, length = found.surfaces, self.units.fine_length
        if surfaces is None:
            self.view.show_image("Residual to the surface", None, length, 0.0, 1.0)
            self.numbers.clear()
            return
        mask = found.pixels.mask
        limit = 3.0 * float(np.std(surfaces.residual_m[mask])) if mask.any() else 1e-3
        self.view.show_image("Mean range minus surface", surfaces.residual_m, length, -limit, limit)
        self._show_numbers(found)

    def _show_numbers(self, found: Identification) -> None:
        length, units, surfaces = self.units.fine_length, self.units, found.surfaces
        self.numbers.set("chosen", surfaces.chosen)
        residual = surfaces.residual_m[found.pixels.mask]
        rms = float(np.sqrt(np.mean(residual**2))) if residual.size else None
        self.numbers.set("residual, rms", length.text(rms))
        for name, rms in surfaces.left_out_rms_m.items():
            self.numbers.set(f"misfit of {name}", f"{length.text(rms)} rms")
        axes = " · ".join(
            f"{units.length.from_si(a):.{units.length.digits}f}" for a in surfaces.cap.semi_axes_m
        )
        self.numbers.set("ellipsoid's semi-axes", f"{axes} {units.length.symbol}")
        radius = float(surfaces.sphere.semi_axes_m[0])
        self.numbers.set("sphere's radius", units.length.text(radius))
        self.numbers.set(
            "edge of the measured points above the rim plane",
            units.length.with_interval(surfaces.rim_height_m, 1.96 * surfaces.rim_height_sigma_m),
        )


# Step 4: γ0 from the Young–Laplace equation, with its interval and local values.


SPREAD = 0.2
"""Relative deviation from γ0 at the ends of the colour scale."""


class TensionPage(Page):
    """γ0 with its interval, and the contributions to it."""

    name = "γ0"
    title = "γ0"
    task = "Read γ0 with its interval and the verdict below; the next two steps are optional."
    next_title = "Estimate γ0"
    step = Step.TENSION

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.view = ImageView()
        self.numbers = NumberForm()
        fill(self.column, self.view, self.numbers, 1)

    def show_answer(self, answer: Answer) -> None:
        units, found, unit = self.units, answer.found, self.units.tension
        if not found.complete:
            self.view.show_image("Local γ0", None, unit, 0.0, 1.0)
            self.numbers.clear()
            self.numbers.set("γ0", unit.text(None))
            return
        surfaces, tension = found.surfaces, found.tension
        value = tension.value
        self.view.show_image(
            "Local γ0",
            answer.local_tension,
            unit,
            (1.0 - SPREAD) * value,
            (1.0 + SPREAD) * value,
        )
        show = self.numbers.set
        show("γ0", unit.with_interval(value, tension.half_width))
        show("95 % interval", unit.between(tension.low, tension.high))
        for name, size in surfaces.dimensions.items():
            text = units.length.with_interval(size.value, size.half_width)
            show(name.removesuffix("_m").replace("_", " "), text)
        show("gauge pressure", units.gas_pressure.text(found.gauge.value))
        more = unit.text(100.0 * surfaces.tension_m.value, signed=True)
        show("γ0 per gauge pressure", f"{more} for {units.gas_pressure.text(100.0)} more")
        for name, each in found.tension_by_surface.items():
            show(f"γ0 from the {name}", unit.text(each))
        for name, sigma in found.tension_parts.items():
            show(f"σ of γ0 from {name.replace('_', ' ')}", unit.text(sigma))
