"""Step 3: the reference surface, chosen by the data or by the person."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QComboBox, QFormLayout, QPushButton, QSpinBox

from bubbleviz.calibration.draft import Draft, Step
from bubbleviz.calibration.surface.reference_surface import NAMES, Surfaces, mean_points
from bubbleviz_ui.calibration.calibration_answer import Answer
from bubbleviz_ui.calibration.calibration_page import Numbers, Page
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.calibration.image_view import ImageView
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell.layouts import fill


class SurfacePage(Page):
    """Residual to the surface, misfit of each, dimensions.

    Attributes
    ----------
    painted : Signal
        Points (k, 3) in m and a number for each in m, to be painted in the 3-D view.
    """

    name = "Surface"
    title = "Reference surface"
    todo = "Check that what the surface leaves over looks like noise; else choose another."
    sets = ("surface", "nodes")
    next_title = "Fit the surface"
    painted = Signal(object, object)

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.view = ImageView("around zero")
        self.choice = QComboBox()
        self.choice.addItem("as the data say", None)
        for name in NAMES:
            self.choice.addItem(name, name)
        self.nodes = QSpinBox(minimum=30, maximum=20_000, singleStep=100)
        self.nodes.setKeyboardTracking(False)
        self.paint = QPushButton("Paint the residual in the 3-D view")
        self.choice.setToolTip("Shape of the reference surface x0 (Eq. 1)")
        self.nodes.setToolTip("Nodes of the mesh that the surface is meshed with")
        self.paint.setToolTip("Measured minus fitted range at the points of the membrane")
        self.numbers = Numbers()
        form = QFormLayout()
        form.addRow("Surface", self.choice)
        form.addRow("Nodes of the mesh", self.nodes)
        fill(self.column, self.view, form, self.numbers, self.paint, 1)
        self.choice.activated.connect(
            lambda row: calibration.edit("Choose the surface", surface=self.choice.itemData(row))
        )
        self.nodes.valueChanged.connect(lambda n: calibration.edit("Nodes of the mesh", nodes=n))
        self.paint.clicked.connect(self._paint)

    def enter(self) -> None:
        """Fit the surfaces."""
        self.calibration.reach(Step.SURFACE, self.next_title)

    def is_done(self, answer: Answer) -> bool:
        """Whether there is a surface."""
        return answer.work.settings.reached >= Step.SURFACE

    def show_answer(self, answer: Answer) -> None:
        """Show the residual and the misfits."""
        settings, draft = self.calibration.settings, answer.draft
        self.choice.setCurrentIndex(self.choice.findData(settings.surface))
        with QSignalBlocker(self.nodes):
            self.nodes.setValue(settings.nodes)
        surfaces, length = draft.surfaces, self.units.fine_length
        self.paint.setEnabled(surfaces is not None)
        if surfaces is None or draft.pixels is None:
            self.view.show_image("Residual to the surface", None, length, 0.0, 1.0)
            return
        mask = draft.pixels.mask
        limit = 3.0 * float(np.std(surfaces.residual_m[mask])) if mask.any() else 1e-3
        self.view.show_image("Mean range minus surface", surfaces.residual_m, length, -limit, limit)
        self._show_numbers(draft, surfaces)

    def _show_numbers(self, draft: Draft, surfaces: Surfaces) -> None:
        length, units = self.units.fine_length, self.units
        self.numbers.set("chosen", surfaces.chosen)
        if draft.pixels is not None:
            left = surfaces.residual_m[draft.pixels.mask]
            rms = float(np.sqrt(np.mean(left**2))) if left.size else None
            self.numbers.set("residual, rms", length.text(rms))
        for name, rms in surfaces.left_out_rms_m.items():
            self.numbers.set(f"{name} misses by", f"{length.text(rms)} rms")
        axes = " · ".join(
            f"{units.length.of(a):.{units.length.digits}f}"
            for a in surfaces.fits.ellipsoid.ellipsoid.semi_axes_m
        )
        self.numbers.set("ellipsoid's semi-axes", f"{axes} {units.length.symbol}")
        radius = float(surfaces.fits.sphere.ellipsoid.semi_axes_m[0])
        self.numbers.set("sphere's radius", units.length.text(radius))
        fits = surfaces.fits
        self.numbers.set(
            "rim by the cloud",
            units.length.with_interval(fits.rim_height_m, 1.96 * fits.rim_height_sigma_m),
        )

    def _paint(self) -> None:
        draft = self.calibration.answer.draft
        if draft.surfaces is None or draft.samples is None:
            return
        pixels = np.flatnonzero(np.isfinite(draft.surfaces.residual_m))
        points = mean_points(draft.samples, draft.samples.camera, pixels)
        self.painted.emit(points, draft.surfaces.residual_m.ravel()[pixels])
