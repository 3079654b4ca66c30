"""Step 4: γ0 by Young–Laplace, its interval, and its spread over the surface."""

from __future__ import annotations

from bubbleviz.calibration.draft import Step
from bubbleviz_ui.calibration.calibration_answer import Answer
from bubbleviz_ui.calibration.calibration_page import Numbers, Page
from bubbleviz_ui.calibration.calibration_session import Calibration
from bubbleviz_ui.calibration.image_view import ImageView
from bubbleviz_ui.model.units import Units
from bubbleviz_ui.shell.layouts import fill

SPREAD = 0.2
"""Of γ0, at the ends of the picture's colours."""


class TensionPage(Page):
    """γ0 ± its interval and what the interval is made of."""

    name = "γ0"
    title = "γ0"
    todo = "Read γ0 with its interval and the verdict below; the next two steps are optional."
    next_title = "Estimate γ0"

    def __init__(self, calibration: Calibration, units: Units) -> None:
        super().__init__(calibration, units)
        self.view = ImageView()
        self.numbers = Numbers()
        fill(self.column, self.view, self.numbers, 1)

    def enter(self) -> None:
        """Estimate γ0."""
        self.calibration.reach(Step.TENSION, self.next_title)

    def is_done(self, answer: Answer) -> bool:
        """Whether γ0 is estimated."""
        return answer.work.settings.reached >= Step.TENSION

    def show_answer(self, answer: Answer) -> None:
        """Show γ0 and its parts."""
        units, estimate = self.units, answer.draft.tension
        unit = units.tension
        if estimate is None:
            self.view.show_image("γ0 of each neighbourhood", None, unit, 0.0, 1.0)
            self.numbers.set("γ0", unit.text(None))
            return
        value = estimate.tension.value
        self.view.show_image(
            "γ0 of each neighbourhood",
            answer.local_tension,
            unit,
            (1.0 - SPREAD) * value,
            (1.0 + SPREAD) * value,
        )
        say = self.numbers.set
        say("γ0", unit.with_interval(value, estimate.tension.half_width))
        say("95 % interval", unit.between(estimate.tension.low, estimate.tension.high))
        for name, size in estimate.dimensions.items():
            text = units.length.with_interval(size.value, size.half_width)
            say(name.removesuffix("_m").replace("_", " "), text)
        say("gauge pressure", units.gas_pressure.text(estimate.gauge_pressure_pa))
        more = unit.text(100.0 * estimate.per_pascal, signed=True)
        say("γ0 by gauge pressure", f"{more} for {units.gas_pressure.text(100.0)} more")
        for name, each in estimate.by_surface.items():
            say(f"γ0 by the {name}", unit.text(each))
        for name, sigma in estimate.parts.items():
            say(f"σ from {name.replace('_', ' ')}", unit.text(sigma))
