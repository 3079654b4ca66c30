"""Display units: conversion and formatting of SI values."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bubbleviz.wording import decimals_of, plus_minus, rounded

DASH = "–"
"""Shown in place of a missing number."""


@dataclass(frozen=True)
class Unit:
    """A display unit."""

    symbol: str
    per_si: float  # Display units per SI unit
    digits: int  # Decimals shown

    def from_si(self, si: float) -> float:
        """Displayed number of an SI value."""
        return si * self.per_si

    def to_si(self, shown: float) -> float:
        """SI value of a displayed number."""
        return shown / self.per_si

    def text(self, si: float | None, *, signed: bool = False) -> str:
        """Number and unit; a dash if it is not finite."""
        if si is None or not math.isfinite(si):
            return DASH
        shown = round(self.from_si(si), self.digits) + 0.0  # no "-0.00"
        sign = "+" if signed else ""
        return f"{shown:{sign}.{self.digits}f} {self.symbol}"

    def rough(self, si: float) -> str:
        """Number without an interval, to two significant digits, and unit."""
        shown = self.from_si(si)
        return f"{rounded(shown, decimals_of(shown, self.digits))} {self.symbol}"

    def with_interval(self, si: float | None, half_width: float | None) -> str:
        """Text: number ± half of its 95 % interval, rounded to significant digits, with unit."""
        if si is None or half_width is None or not math.isfinite(si + half_width):
            return self.text(si)
        shown = plus_minus(self.from_si(si), self.from_si(half_width), self.digits)
        return f"{shown} {self.symbol}"

    def between(self, low: float, high: float) -> str:
        """Ends of a 95 % interval, rounded to significant digits, and unit."""
        low, high = self.from_si(low), self.from_si(high)
        decimals = decimals_of(0.5 * (high - low), self.digits)
        return f"{rounded(low, decimals)} … {rounded(high, decimals)} {self.symbol}"

    def with_range(self, si: float, low: float, high: float) -> str:
        """Number, its range in parentheses unless that is empty, and unit.

        A range from about 0 is given by its end, as (0…140) looks like no contact.
        """
        if high <= 0.0 or not math.isfinite(si + low + high):
            return self.text(si)
        value, least, most = (f"{self.from_si(each):.{self.digits}f}" for each in (si, low, high))
        return f"{value} ({f'{least}…' if float(least) else 'up to '}{most}) {self.symbol}"


DIMENSIONLESS = Unit("", 1.0, 2)
"""Unit of dimensionless numbers."""


class SignificantPercent(Unit):
    """Per cent with `digits` significant digits, as the value may be far below one."""

    def text(self, si: float | None, *, signed: bool = False) -> str:
        """Number and unit; a dash if it is not finite."""
        if si is None or not math.isfinite(si):
            return super().text(si)
        return f"{self.from_si(si):{'+' if signed else ''}.{self.digits}g} {self.symbol}"


PSI = 6894.757293168
"""Pascals in a pound-force per square inch (NIST SP 811)."""

UNIT_CHOICES: dict[str, dict[str, dict[str, Unit]]] = {
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
    "force_unit": {"N": {"force": Unit("N", 1.0, 2)}, "mN": {"force": Unit("mN", 1e3, 0)}},
    "duration_unit": {
        "ms": {"duration": Unit("ms", 1.0, 1)},
        "s": {"duration": Unit("s", 1e-3, 4)},
    },
}
"""Units that can be chosen, by setting. Durations are given in ms, not s (`Result.times_ms`)."""


class Units:
    """Units of everything the window shows; one shared object, updated by `use`."""

    # pressure, gas_pressure, force, area, length, fine_length, volume, duration: Chosen by the user
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
    range_share = SignificantPercent("% of the range", 100.0, 3)
    rate = Unit("Hz", 1.0, 1)
    render_rate = Unit("fps", 1.0, 0)

    def __init__(self) -> None:
        self.use({name: next(iter(system)) for name, system in UNIT_CHOICES.items()})

    def use(self, chosen: dict[str, str]) -> None:
        """Choose units by the names in `UNIT_CHOICES`."""
        for name, symbol in chosen.items():
            for quantity, unit in UNIT_CHOICES[name][symbol].items():
                setattr(self, quantity, unit)
