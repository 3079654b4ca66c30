"""What shear told over many frames, in numbers and in words."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from bubbleviz.diagnostics.shear_numbers import Measure, ShearNumbers
from bubbleviz.result import HALF_95, Result


@dataclass(frozen=True)
class ShearSummary:
    """Shear of many frames; numbers are None where there are none to trust."""

    status: dict[str, int]  # number of frames by status of the traction
    reference: str  # what flow was measured against, or why there was nothing
    # max_force_n, max_force_sigma_n: highest |force| with friction, and its standard deviation, N
    max_force_n: float | None = None
    max_force_sigma_n: float | None = None
    # torque_nm, torque_sigma_nm: in that frame, about the mean normal through the contact's centre,
    # N·m
    torque_nm: float | None = None
    torque_sigma_nm: float | None = None
    # slip_share, slip_share_sigma: in that frame, 0 to 1
    slip_share: float | None = None
    slip_share_sigma: float | None = None

    def to_text(self) -> str:
        """Lines for the terminal; ± is half of the 95 % interval."""
        status = ", ".join(f"{count} {name}" for name, count in self.status.items())
        lines = [f"shear    {status or 'no frame'}"]
        if self.max_force_n is not None:
            numbers = _words(
                _measure(self.max_force_n, self.max_force_sigma_n),
                _measure(self.torque_nm, self.torque_sigma_nm),
                _measure(self.slip_share, self.slip_share_sigma),
            )
            lines += [f"         {numbers}, where the force was highest; ±: 95 % interval"]
            lines += ["         its direction has not been verified"]
        return "\n".join([*lines, *(f"         {line}" for line in filter(None, [self.reference]))])


class ShearTally:
    """Counts frames by the status of their traction, and keeps the numbers of the largest force."""

    def __init__(self) -> None:
        self._status: Counter[str] = Counter()
        self._highest: ShearNumbers | None = None

    def add(self, result: Result) -> None:
        """Take a frame."""
        traction = result.traction
        if traction is None:
            return
        self._status[traction.status] += 1
        if traction.status == "ok":
            numbers = ShearNumbers.of(traction, result.slip)
            if self._highest is None or numbers.force_n > self._highest.force_n:
                self._highest = numbers

    def summary(self, reference: str) -> ShearSummary:
        """The frames so far."""
        if self._highest is None:
            return ShearSummary(dict(self._status), reference)
        found = self._highest
        measures = (found.force_n, found.torque_nm, found.slip_share)
        numbers = [_known(x) for value, half in measures for x in (value, half / HALF_95)]
        return ShearSummary(dict(self._status), reference, *numbers)


def shear_line(result: Result) -> str:
    """Force with friction, torque and slip of one frame, or why there are none, in one line."""
    traction = result.traction
    if traction is None or traction.status == "no_contact":
        return ""
    if traction.status != "ok":
        status = traction.status.replace("_", " ")
        return f"{status}: {traction.reason}" if traction.reason else status
    numbers = ShearNumbers.of(traction, result.slip)
    return _words(numbers.force_n, numbers.torque_nm, numbers.slip_share)


def _words(force_n: Measure, torque_nm: Measure, slip_share: Measure) -> str:
    parts = [
        f"force {force_n[0]:.2f} ± {force_n[1]:.2g} N with friction",
        f"torque {1e3 * torque_nm[0]:.3g} ± {1e3 * torque_nm[1]:.2g} N·mm",
    ]
    if math.isfinite(slip_share[0]):
        parts.append(f"slip {1e2 * slip_share[0]:.0f} ± {1e2 * slip_share[1]:.2g} %")
    return ", ".join(parts)


def _measure(value: float | None, sigma: float | None) -> Measure:
    return math.nan if value is None else value, HALF_95 * (math.nan if sigma is None else sigma)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None  # JSON has no NaN
