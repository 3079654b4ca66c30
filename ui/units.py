"""SI values in the operator's units: the only place where a number gets its unit."""

from __future__ import annotations

import math
from dataclasses import dataclass

NOTHING = "–"
"""Shown where there is no number."""


@dataclass(frozen=True)
class Unit:
    """A display unit.

    Attributes
    ----------
    symbol : str
        What is written behind the number.
    per_si : float
        Displayed number of one SI unit.
    digits : int
        Decimals shown.
    """

    symbol: str
    per_si: float
    digits: int

    def of(self, si: float) -> float:
        """Number to display for a value in SI."""
        return si * self.per_si

    def to_si(self, shown: float) -> float:
        """Value in SI of a displayed number."""
        return shown / self.per_si

    def text(self, si: float | None, *, signed: bool = False) -> str:
        """Number and unit; a dash and the unit where there is no finite number."""
        if si is None or not math.isfinite(si):
            return f"{NOTHING} {self.symbol}"
        shown = round(self.of(si), self.digits) + 0.0  # no "-0.00"
        sign = "+" if signed else ""
        return f"{shown:{sign}.{self.digits}f} {self.symbol}"

    def with_interval(self, si: float | None, half_width: float | None) -> str:
        """Number ± half of its 95 % interval, and unit."""
        if si is None or half_width is None:
            return self.text(si)
        return (
            f"{self.of(si):.{self.digits}f} ± {self.of(half_width):.{self.digits}f} {self.symbol}"
        )


@dataclass(frozen=True)
class Units:
    """The units of everything the window shows."""

    pressure: Unit = Unit("kPa", 1e-3, 2)
    gas_pressure: Unit = Unit("Pa", 1.0, 0)
    force: Unit = Unit("N", 1.0, 2)
    area: Unit = Unit("mm²", 1e6, 0)
    length: Unit = Unit("mm", 1e3, 2)
    time: Unit = Unit("s", 1.0, 3)
    fine_length: Unit = Unit("mm", 1e3, 3)
    tension: Unit = Unit("N/m", 1.0, 2)
    volume: Unit = Unit("cm³", 1e6, 1)
    share: Unit = Unit("%", 100.0, 1)
    rate: Unit = Unit("Hz", 1.0, 1)
    render_rate: Unit = Unit("fps", 1.0, 0)
    duration: Unit = Unit("ms", 1.0, 1)
    """Durations of stages arrive in ms already (`Result.times_ms`)."""
