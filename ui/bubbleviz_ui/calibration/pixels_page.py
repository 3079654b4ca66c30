"""Steps 2 to 4: pixel mask, reference surface, tension γ0."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QSignalBlocker
from PySide6.QtWidgets import QComboBox, QDoubleSpinBox, QSpinBox

from bubbleviz.calibration import SURFACE_NAMES, Identification, Step
from bubbleviz.wording import count_of
from bubbleviz_ui.calibration.calibration_page import ImageView, NumberForm, Page
from bubbleviz_ui.calibration.calibration_session import Answer, Calibration
from bubbleviz_ui.model.units import DASH, Unit, Units
from bubbleviz_ui.shell.binding import SliderBox, form, options
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
        self.validity = _threshold(
            units.share,
            1.0,
            "Share of the frames in which a pixel must have valid depth to be used; lowest value: "
            "automatic",
        )
        self.validity.box.setSpecialValueText("automatic")
        self.deviations = _threshold(
            Unit("σ", 1.0, 1),
            MOST_DEVIATIONS,
            "Pixels with noise or offset beyond this many robust standard deviations are excluded",
        )
        self.numbers = NumberForm()
        rows = form(
            ("Picture", self.picture),
            ("Minimum validity", self.validity),
            ("Maximum deviation", self.deviations),
        )
        fill(self.column, self.view, rows, self.numbers, 1)
        self.picture.currentIndexChanged.connect(lambda _: self._show_picture(calibration.answer))
        self.validity.valueChanged.connect(
            lambda shown: calibration.edit(
                "Validity threshold", dragged=True, min_validity=units.share.to_si(shown) or None
            )
        )
        self.deviations.valueChanged.connect(
            lambda shown: calibration.edit(
                "Deviation threshold", dragged=True, deviations=max(shown, 0.1)
            )
        )

    def show_answer(self, answer: Answer) -> None:
        settings = self.calibration.settings
        validity = self.units.share.from_si(settings.min_validity or 0.0)
        for control, value in ((self.validity, validity), (self.deviations, settings.deviations)):
            control.show_value(value)
        self._show_picture(answer)
        self.numbers.write(self._numbers(answer.found))

    def _numbers(self, found: Identification) -> dict[str, str]:
        samples, pixels = found.samples, found.pixels
        if samples is None or pixels is None:
            return {}
        statistics, used = samples.statistics, int(pixels.mask.sum())
        noise = float(np.median(pixels.noise_m[pixels.mask])) if used else None
        effective = f"{statistics.effective_frames:.1f}"
        return {
            "used": f"{used} of {pixels.mask.size} pixels",
            "noise of a pixel": self.units.fine_length.text(noise),
            **{
                f"excluded, {reason.replace('_', ' ')}": count_of(count, "pixel")
                for reason, count in pixels.removed.items()
            },
            "one independent sample": f"{statistics.correlated_pixels:.1f} pixels",
            "frames": f"{statistics.frames}, as good as {effective} independent ones",
        }

    def _show_picture(self, answer: Answer) -> None:
        samples, pixels = answer.found.samples, answer.found.pixels
        which = self.picture.currentText()
        if samples is None or pixels is None:
            self.view.show_image(which, None, USED)
        elif which == PICTURES[0]:
            self.view.show_image("Pixels used: bright", pixels.mask.astype(float), USED)
        elif which == PICTURES[1]:
            noise = samples.statistics.noise_m.astype(float)
            mask = pixels.mask if pixels.mask.any() else np.isfinite(noise)
            top = float(np.nanpercentile(noise[mask], 99.0))
            title = "Standard deviation of one frame's range"
            self.view.show_image(title, noise, self.units.fine_length, 0.0, top)
        else:
            validity = samples.statistics.validity.astype(float)
            title = "Share of the frames with valid depth"
            self.view.show_image(title, validity, self.units.share)


def _threshold(unit: Unit, highest_si: float, tip: str) -> SliderBox:
    box = QDoubleSpinBox(decimals=unit.digits, suffix=f" {unit.symbol}")
    box.setRange(0.0, unit.from_si(highest_si))
    return SliderBox(box, tip)


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
        rows = form(("Surface", self.choice), ("Nodes of the mesh", self.nodes))
        fill(self.column, self.view, rows, self.numbers, 1)
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
            self.view.show_image("Residual to the surface", None, length)
            self.numbers.write({})
            return
        residual = surfaces.residual_m[found.pixels.mask]
        limit = 3.0 * float(np.std(residual)) if residual.size else 1e-3
        self.view.show_image("Mean range minus surface", surfaces.residual_m, length, -limit, limit)
        rms = float(np.sqrt(np.mean(residual**2))) if residual.size else None
        rim_half = 1.96 * surfaces.rim_height_sigma_m
        unit = self.units.length
        axes = " · ".join(f"{unit.from_si(a):.{unit.digits}f}" for a in surfaces.cap.semi_axes_m)
        misfits = surfaces.left_out_rms_m.items()
        self.numbers.write(
            {
                "chosen": surfaces.chosen,
                "residual, rms": length.text(rms),
                **{f"misfit of {name}": f"{length.text(each)} rms" for name, each in misfits},
                "ellipsoid's semi-axes": f"{axes} {unit.symbol}",
                "sphere's radius": unit.text(float(surfaces.sphere.semi_axes_m[0])),
                "edge of the measured points above the rim plane": unit.with_interval(
                    surfaces.rim_height_m, rim_half
                ),
            }
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
        found, unit = answer.found, self.units.tension
        value = found.tension.value if found.complete else 1.0
        ends = (1.0 - SPREAD) * value, (1.0 + SPREAD) * value
        self.view.show_image("Local γ0", answer.local_tension, unit, *ends)
        self.numbers.write(self._numbers(found) if found.complete else {"γ0": DASH})

    def _numbers(self, found: Identification) -> dict[str, str]:
        units, unit, tension = self.units, self.units.tension, found.tension
        more = unit.text(100.0 * found.surfaces.tension_m.value, signed=True)
        return {
            "γ0": unit.with_interval(tension.value, tension.half_width),
            "95 % interval": unit.between(tension.low, tension.high),
            **{
                name.removesuffix("_m").replace("_", " "): units.length.with_interval(
                    size.value, size.half_width
                )
                for name, size in found.surfaces.dimensions.items()
            },
            "gauge pressure": units.gas_pressure.text(found.gauge.value),
            "γ0 per gauge pressure": f"{more} for {units.gas_pressure.text(100.0)} more",
            **{f"γ0 from the {k}": unit.text(v) for k, v in found.tension_by_surface.items()},
            **{
                f"σ of γ0 from {name.replace('_', ' ')}": unit.text(sigma)
                for name, sigma in found.tension_parts.items()
            },
        }
