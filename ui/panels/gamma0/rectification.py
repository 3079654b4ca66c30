"""Step 5: what each pixel is off by, before and after."""

from __future__ import annotations

import numpy as np

from ui.calibration.answer import Answer
from ui.calibration.session import Calibration
from ui.panels.gamma0.images import ImageView
from ui.panels.gamma0.page import Numbers, Page
from ui.units import Units


class RectificationPage(Page):
    """Residual of the last frame before and after rectification."""

    title = "Rectification"
    next_title = "Look at the rectification"

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.before, self.after = ImageView(), ImageView()
        self.numbers = Numbers()
        for widget in (self.before, self.after):
            self.column.addWidget(widget)
        self.column.addWidget(self.numbers)
        self.column.addStretch(1)

    def show_answer(self, answer: Answer) -> None:
        """Show both images and their rms."""
        unit, last = self.units.fine_length, answer.last
        before = last.before_m if last is not None else None
        after = last.after_m if last is not None else None
        limit = 3.0 * float(np.nanstd(before)) if before is not None else 1.0
        for view, title, image in (
            (self.before, "Last frame before", before),
            (self.after, "Last frame after", after),
        ):
            view.show_image(title, image, unit, -limit, limit, diverging=True)
        for name, image in (("rms before", before), ("rms after", after)):
            rms = float(np.sqrt(np.nanmean(image**2))) if image is not None else None
            self.numbers.set(name, unit.text(rms))
