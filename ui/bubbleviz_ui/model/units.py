"""SI values in the operator's units: the only place where a number gets its unit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bubbleviz.wording import decimals_of, rounded

NOTHING = "–"
"""Shown where there is no number."""


@dataclass(frozen=True)
class Unit:
    """A display unit."""

    symbol: str  # What is written behind the number
    per_si: float  # Displayed number of one SI unit
    digits: int  # Decimals shown

    def of(self, si: float) -> float:
        """Number to display for a value in SI."""
        return si * self.per_si

    def to_si(self, shown: float) -> float:
        """Value in SI of a displayed number."""
        return shown / self.per_si

    def text(self, si: float | None, *, signed: bool = False) -> str:
        """Number and unit; a dash where there is no finite number."""
        if si is None or not math.isfinite(si):
            return NOTHING
        shown = round(self.of(si), self.digits) + 0.0  # no "-0.00"
        sign = "+" if signed else ""
        return f"{shown:{sign}.{self.digits}f} {self.symbol}"

    def with_interval(self, si: float | None, half_width: float | None) -> str:
        """Number ± half of its 95 % interval, to the digits that this leaves, and unit.

        The half is 0 only where it is exactly 0.
        """
        if si is None or half_width is None or not math.isfinite(si + half_width):
            return self.text(si)
        shown = self.of(half_width)
        if half_width > 0.0:
            shown = max(shown, 10.0**-self.digits)
        decimals = decimals_of(shown, self.digits)
        number, shown_half = (rounded(each, decimals) for each in (self.of(si), shown))
        return f"{number} ± {shown_half} {self.symbol}"

    def between(self, low: float, high: float) -> str:
        """Ends of a 95 % interval, to the digits that its width leaves, and unit."""
        low, high = self.of(low), self.of(high)
        decimals = decimals_of(0.5 * (high - low), self.digits)
        return f"{rounded(low, decimals)} … {rounded(high, decimals)} {self.symbol}"

    def with_range(self, si: float, low: float, high: float) -> str:
        """Number, the range it may be in unless that is empty, and unit."""
        if high <= 0.0 or not math.isfinite(si + low + high):
            return self.text(si)
        value, least, most = (f"{self.of(each):.{self.digits}f}" for each in (si, low, high))
        return f"{value} ({least}…{most}) {self.symbol}"


PLAIN = Unit("", 1.0, 2)
"""Of numbers without one."""


class Share(Unit):
    """Per cent of something, to `digits` significant ones: it may be far below one."""

    def text(self, si: float | None, *, signed: bool = False) -> str:
        """Number and unit; a dash where there is no finite number."""
        if si is None or not math.isfinite(si):
            return super().text(si)
        return f"{self.of(si):{'+' if signed else ''}.{self.digits}g} {self.symbol}"


PSI = 6894.757293168
"""Pascals in a pound-force per square inch (NIST SP 811)."""

SYSTEMS: dict[str, dict[str, dict[str, Unit]]] = {
    "length_unit": {
        "mm": {
            "length": Unit("mm", 1e3, 2),
            "fine_length": Unit("mm", 1e3, 3),
            "area": Unit("mm²", 1e6, 0),
            "volume": Unit("cm³", 1e6, 1),
        },
        "m": {
            "length": Unit("m", 1.0, 5),
            "fine_length": Unit("m", 1.0, 6),
            "area": Unit("m²", 1.0, 6),
            "volume": Unit("m³", 1.0, 7),
        },
    },
    "pressure_unit": {
        "kPa": {"pressure": Unit("kPa", 1e-3, 2), "gas_pressure": Unit("Pa", 1.0, 0)},
        "Pa": {"pressure": Unit("Pa", 1.0, 0), "gas_pressure": Unit("Pa", 1.0, 0)},
        "psi": {"pressure": Unit("psi", 1 / PSI, 3), "gas_pressure": Unit("psi", 1 / PSI, 4)},
    },
    "force_unit": {
        "N": {"force": Unit("N", 1.0, 2)},
        "mN": {"force": Unit("mN", 1e3, 0)},
    },
    "duration_unit": {
        "ms": {"duration": Unit("ms", 1.0, 1)},
        "s": {"duration": Unit("s", 1e-3, 4)},
    },
}
"""Units of `Units` by what the operator chooses. Durations of stages arrive in ms already
(`Result.times_ms`)."""


class Units:
    """The units of everything the window shows; who holds it sees what the operator chooses."""

    # pressure, gas_pressure, force, area, length, fine_length, volume, duration: Of the operator's
    # choice
    pressure: Unit
    gas_pressure: Unit
    force: Unit
    area: Unit
    length: Unit
    fine_length: Unit
    volume: Unit
    duration: Unit
    time = Unit("s", 1.0, 3)
    tension = Unit("N/m", 1.0, 2)
    torque = Unit("N·mm", 1e3, 1)
    angle = Unit("°", 1.0, 0)
    pixels = Unit("px", 1.0, 2)
    share = Unit("%", 100.0, 1)
    range_share = Share("% of the range", 100.0, 3)
    rate = Unit("Hz", 1.0, 1)
    render_rate = Unit("fps", 1.0, 0)

    def __init__(self) -> None:
        self.use({name: next(iter(system)) for name, system in SYSTEMS.items()})

    def use(self, chosen: dict[str, str]) -> None:
        """Take a choice of `SYSTEMS`, by name."""
        for name, symbol in chosen.items():
            for quantity, unit in SYSTEMS[name][symbol].items():
                setattr(self, quantity, unit)
