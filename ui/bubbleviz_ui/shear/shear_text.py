"""Force with friction and slip in words and numbers; ± is half of the 95 % interval."""

from __future__ import annotations

import math

from bubbleviz.diagnostics.shear_numbers import Measure, ShearNumbers
from bubbleviz.result import Result
from bubbleviz_ui.model.units import NOTHING, Unit, Units

NUMBERS = {
    "force": "Force |F|", "normal": "Normal", "tangential": "Tangential",
    "direction": "Direction", "torque": "Torque", "displacement": "Displacement", "slip": "Slip",
}  # fmt: skip
"""Titles of the numbers by name."""
TIPS = {
    "force": "Length of the force of the object on the membrane",
    "normal": "Along the mean normal of the contact, into the sensor",
    "tangential": "Across the mean normal of the contact",
    "direction": "Of the tangential force, from x towards y of the bubble frame, seen along z",
    "torque": "About the mean normal through the contact's centre",
    "displacement": "Largest displacement along the membrane where it is touched",
    "slip": "Share of the patch that moved against the rest of it, over the frames that were"
    " looked at since contact; none where too little of it sticks to tell",
}
UNVERIFIED = "not verified on real sensors"
STATES = {
    "ok": "depth and texture",
    "no_contact": "nothing touches the membrane",
    "depth_alone": "depth alone",
    "no_data": "no depth image to trust",
    "not_converged": "no solution to trust",
}


def shear_words(result: Result | None, units: Units) -> dict[str, str]:
    """Texts by name, `state` among them."""
    traction = None if result is None else result.traction
    if result is None or traction is None:
        return dict.fromkeys(("state", *NUMBERS), NOTHING)
    numbers = ShearNumbers.of(traction, result.slip)
    angle = _text(numbers.direction_deg, units.angle)
    known = math.isfinite(numbers.direction_deg[0])
    reason = f": {traction.reason}" if traction.reason else ""
    return {
        "state": STATES[traction.status] + reason,
        "force": _text(numbers.force_n, units.force),
        "normal": _text(numbers.normal_n, units.force),
        "tangential": _text(numbers.tangential_n, units.force),
        "direction": f"{angle}, {UNVERIFIED}" if known else NOTHING,
        "torque": _text(numbers.torque_nm, units.torque),
        "displacement": _text(numbers.displacement_m, units.length),
        "slip": _text(numbers.slip_share, units.share),
    }


def copied_shear(result: Result, units: Units) -> str:
    """The same as lines of text, for other programs."""
    words = shear_words(result, units)
    lines = [f"frame {result.frame.index}, {units.time.text(result.frame.time_s)}"]
    lines += [f"status: {words['state']}"]
    lines += [f"{title}: {words[name]}" for name, title in NUMBERS.items()]
    return "\n".join(lines)


def _text(measure: Measure, unit: Unit) -> str:
    return unit.with_interval(*measure)
