"""Shear panel: settings of the traction with friction, and its numbers."""

from __future__ import annotations

import math

import numpy as np
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QFormLayout, QHBoxLayout, QLabel, QVBoxLayout, QWidget

from bubbleviz.diagnostics import Measure, ShearNumbers
from bubbleviz.result import Result
from bubbleviz_ui.engine.controller import Controller
from bubbleviz_ui.model.session_state import SessionState
from bubbleviz_ui.model.units import DASH, UNIT_CHOICES, Unit, Units
from bubbleviz_ui.panels.plot_host import Part, Plot, PlotHost
from bubbleviz_ui.shell import theme
from bubbleviz_ui.shell.dock import fill, push_button
from bubbleviz_ui.shell.theme import BLUE

# Plot of the force across the mean normal and its 95 % region.


HEIGHT = 170  # screen pixels


class ShearPlot(PlotHost):
    """The force as a line from the origin, with an ellipse around its end."""

    def __init__(self) -> None:
        super().__init__(self._fill)
        self.setFixedHeight(HEIGHT)
        self.setToolTip(
            "Force across the mean normal along x and y of the bubble frame, with its 95 % region"
        )

    def _fill(self) -> list[Part]:
        self._plot = Plot("number")
        self._plot.box.setAspectLocked(True)
        self.force, self.outline = (self._plot.add_curve(BLUE, width=k) for k in (2, 1))
        self.arrange([self._plot.item])
        return [self._plot]

    def draw(self, numbers: ShearNumbers, unit: Unit) -> None:
        """Draw the tangential force in a unit, if there is one."""
        if not self.ready:
            return
        self._plot.write(f"Across normal, {unit.symbol}")
        across = numbers.across_n
        for item, points in (
            (self.force, None if across is None else np.vstack([np.zeros(2), across])),
            (self.outline, numbers.outline_n),
        ):
            item.setData(unit.from_si(1.0) * (np.empty((0, 2)) if points is None else points))


# Texts of force with friction, and of slip; ± is half of the 95 % interval.

NUMBERS = {
    "force": "Force |F|", "normal": "Along normal", "tangential": "Across normal",
    "direction": "Direction", "torque": "Torque", "displacement": "Displacement", "slip": "Slip",
}  # fmt: skip
"""Titles of the numbers by name."""
TIPS = {
    "force": "Magnitude of the force of the object on the membrane",
    "normal": "Component along the mean normal of the contact, into the sensor",
    "tangential": "Component across the mean normal of the contact; differs from friction in the "
    "readout, which acts along the curved membrane",
    "direction": "Angle of that component about z, from x towards y of the bubble frame",
    "torque": "Torque about the mean normal through the contact's centre",
    "displacement": "Largest displacement along the membrane within the contact",
    "slip": "Share of the patch that slipped since contact, relative to the part that sticks; – "
    "if unknown, for example because too little sticks",
}
UNVERIFIED = "force direction not verified on real sensors"
WIDEST = "≈ 88.88 ± 88.88 N·mm"
"""A number that fits in one line of the narrowest panel."""
STATES = {
    "ok": "depth and texture",
    "no_contact": "no contact",
    "depth_alone": "depth alone",
    "no_data": "no depth data",
    "not_converged": "no trusted solution",
}


def shear_texts(result: Result, units: Units, *, final: bool = True) -> dict[str, str]:
    """Texts by name, including `state`; `final` as for `force_text`."""
    traction = result.traction
    if traction is None:
        return dict.fromkeys(("state", *NUMBERS), DASH)
    numbers = ShearNumbers.of(result)
    known = math.isfinite(numbers.direction_deg[0])
    reason = f": {traction.reason}" if traction.reason else ""
    measures: dict[str, tuple[Measure, Unit]] = {
        "force": (numbers.force_n, units.force),
        "normal": (numbers.normal_n, units.force),
        "tangential": (numbers.tangential_n, units.force),
        "direction": (numbers.direction_deg, units.angle),
        "torque": (numbers.torque_nm, units.torque),
        "displacement": (numbers.displacement_m, units.length),
        "slip": (numbers.slip_share, units.share),
    }
    about = "" if final or traction.status == "no_contact" else "≈ "
    texts = {name: unit.with_interval(*measure) for name, (measure, unit) in measures.items()}
    texts = {name: text if text == DASH else about + text for name, text in texts.items()}
    remark = f"; {UNVERIFIED}" if known else ""
    return {"state": STATES[traction.status] + reason + remark, **texts}


def shear_report(result: Result, units: Units) -> str:
    """Status and numbers as text, for other programs."""
    words = shear_texts(result, units)
    lines = [f"frame {result.frame.index}, {units.time.text(result.frame.time_s)}"]
    lines += [f"status: {words['state']}"]
    lines += [f"{title}: {words[name]}" for name, title in NUMBERS.items()]
    return "\n".join(lines)


SEARCHING = "Looking for contact-free colour images…"


class ShearPanel(QWidget):
    """Settings of the traction with friction, and its numbers with 95 % intervals."""

    def __init__(self, state: SessionState, controller: Controller) -> None:
        super().__init__()
        self._state, self._controller = state, controller
        self.reference = QLabel(DASH, wordWrap=True)
        self.reference.setToolTip(
            "Contact-free colour images from which motion is measured, or why there are none"
        )
        self.search_reference = push_button(
            "Collect again",
            "Find the contact-free colour images again; do not touch a live sensor meanwhile",
            controller.find_reference,
        )
        self.state = QLabel(DASH, wordWrap=True)
        self.values = {name: QLabel(DASH, wordWrap=True) for name in NUMBERS}
        for name, label in self.values.items():
            theme.bold(label)
            label.setToolTip(f"{TIPS[name]}; ± is half of its 95 % interval")
            label.setMinimumWidth(label.fontMetrics().horizontalAdvance(WIDEST))
        self.plot = ShearPlot()
        self.plot.seen.connect(self._write)
        self.copy = push_button("Copy", "Copy these numbers as text, with their units", self._copy)
        self._lay_out()
        controller.shown.connect(self._write)
        state.follow({*UNIT_CHOICES, "panels"}, self._write)

    def _lay_out(self) -> None:
        numbers = QFormLayout()
        numbers.setHorizontalSpacing(16)
        for name, title in NUMBERS.items():
            numbers.addRow(title, self.values[name])
        fill(
            QVBoxLayout(self),
            self.state,
            numbers,
            fill(QHBoxLayout(), QLabel("±: 95 % interval"), 1, self.copy),
            self.plot,
            self.reference,
            fill(QHBoxLayout(), self.search_reference, 1),
            1,
            margins=(12, 10, 12, 12),
        )

    def _write(self) -> None:
        if "shear" not in self._state.settings.panels:
            return
        result, final = self._controller.result, self._state.final
        words, traction = shear_texts(result, self._state.units, final=final), result.traction
        searching = DASH if result.estimate is None else SEARCHING
        self.reference.setText(self._controller.inspection.reference or searching)
        self.state.setText(words["state"])
        said = traction is not None and traction.reason
        self.reference.setVisible(not said or not self.reference.text().endswith(said))
        for name, label in self.values.items():
            label.setText(words[name])
        self.copy.setEnabled(traction is not None and final)
        self.plot.draw(ShearNumbers.of(result), self._state.units.force)

    def _copy(self) -> None:
        result = self._controller.result
        if result.traction is not None:
            QGuiApplication.clipboard().setText(shear_report(result, self._state.units))
