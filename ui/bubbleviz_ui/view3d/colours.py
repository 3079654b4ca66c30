"""Colour maps and colour ranges of the 3-D view."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib import colormaps

from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.settings import Settings
from bubbleviz_ui.model.units import Unit, Units
from bubbleviz_ui.shell import theme

ENTRIES = 256
NEUTRAL_ENTRIES = 5
"""Lowest entries of the pressure map, neutral for no contact."""
BLEND_ENTRIES = 20
DARKEST = 0.28
"""Share of a map omitted because it is as dark as shadows on the membrane."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 … 255, of `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def pressure_colours(name: str) -> np.ndarray:
    """Entries (256, 4) uint8: neutral at zero, then a perceptually uniform map."""
    sampled = colormaps[name](np.linspace(DARKEST, 1.0, ENTRIES))
    values = np.asarray(sampled * 255.0).astype(np.uint8)
    neutral = np.array([*rgb(theme.NEUTRAL), 255], float)
    values[:NEUTRAL_ENTRIES] = neutral
    blend = slice(NEUTRAL_ENTRIES, NEUTRAL_ENTRIES + BLEND_ENTRIES)
    share = np.linspace(0.0, 1.0, BLEND_ENTRIES)[:, None]
    values[blend] = (1 - share) * neutral + share * values[blend]
    return values


def residual_colours(middle: str) -> np.ndarray:
    """Entries (256, 4) uint8: blue where measured nearer than modelled, green where farther.

    `middle` is the colour of zero. Neither end is in the pressure map, so that the two cannot be
    confused.
    """
    ends = (theme.NEARER, middle, theme.FARTHER)
    nearer, between, farther = (np.array([*rgb(colour), 255], float) for colour in ends)
    share = np.linspace(-1.0, 1.0, ENTRIES)[:, None]
    values = np.where(share < 0, nearer, farther) * abs(share) + between * (1.0 - abs(share))
    return values.astype(np.uint8)


def lookup_table(values: np.ndarray) -> Any:
    """VTK lookup table of entries (256, 4) uint8."""
    table = pv.LookupTable()
    table.values = values
    table.nan_color = theme.UNKNOWN
    return table


# Upper ends of the colour and length scales: set by the user, else from the data.


STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
PRESSURE_SHARE = 0.25
"""Smallest end of the pressure scale over the gauge pressure, so that noise stays dark."""
OUTLIERS = 2
"""Frames with the highest pressures that do not extend the scale of other frames."""
RESIDUAL_TIMES_RMS = 3.0  # covers 99.7 % of Gaussian noise
SMALLEST_FORCE_N = 2.0
SMALLEST_RESIDUAL_M = 1e-4  # noise of a depth camera


@dataclass(frozen=True)
class Ranges:
    """Upper ends of the scales in use."""

    pressure_pa: float
    residual_m: float
    force_n: float


def rounded_up(value: float) -> float:
    """Smallest round number (1, 1.5, 2, 3, …, times a power of ten) not below a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step for step in STEPS if step * power >= value * (1 - 1e-9)) * power


class GrowingRanges:
    """Scales that grow with the data and never shrink, so that colours stay comparable.

    The pressure scale covers the frames being shown, and all previous ones except the two highest.
    All sensors of a view share the scales. Ends are round numbers in the displayed units.
    """

    def __init__(self, units: Units) -> None:
        self._units = units
        self._ranges = Ranges(1e3, SMALLEST_RESIDUAL_M, SMALLEST_FORCE_N)
        self._peaks_pa: dict[tuple[object, int], float] = {}
        self._shown_pa: dict[object, float] = {}

    def set_sensor(self, sensor: Sensor) -> None:
        """Reset for another source; frames shown of other sensors stay covered."""
        start = rounded_up(PRESSURE_SHARE * sensor.pneumatics.gauge_pressure_pa)
        self._ranges = Ranges(start, SMALLEST_RESIDUAL_M, SMALLEST_FORCE_N)
        self._peaks_pa = {}

    def include(self, sensor_key: object, result: Result) -> None:
        """Extend the scales to the result shown of a sensor."""
        pressure, residual, force = 0.0, 0.0, 0.0
        estimate, patch = result.trusted_estimate, result.trusted_patch
        if estimate is not None:
            residual = RESIDUAL_TIMES_RMS * estimate.residual_rms_m
            if estimate.status == "ok":
                pressure = float(estimate.contact_pressure_pa.max(initial=0.0))
        if patch is not None:
            force = float(np.linalg.norm(patch.force_n))
        ranges, self._shown_pa[sensor_key] = self._ranges, pressure
        self._ranges = Ranges(
            _grown(
                ranges.pressure_pa,
                self._peak_without_outliers((sensor_key, result.frame.index), pressure),
            ),
            _grown(ranges.residual_m, residual),
            _grown(ranges.force_n, force),
        )

    def forget(self, sensor_key: object) -> None:
        """Drop the result shown of a sensor."""
        self._shown_pa.pop(sensor_key, None)

    def of(self, settings: Settings) -> Ranges:
        """Current scales."""
        pressure = self._ranges.pressure_pa
        for shown in self._shown_pa.values():
            pressure = _grown(pressure, shown)
        units, ranges = self._units, self._ranges
        return Ranges(
            settings.pressure_max_pa or _round_in(units.pressure, pressure),
            settings.residual_max_m or _round_in(units.length, ranges.residual_m),
            ranges.force_n,
        )

    def _peak_without_outliers(self, frame: tuple[object, int], peak_pa: float) -> float:
        """Highest pressure of all frames except the `OUTLIERS` highest, Pa."""
        if math.isfinite(peak_pa):
            self._peaks_pa[frame] = max(peak_pa, self._peaks_pa.get(frame, 0.0))
        highest = sorted(self._peaks_pa.items(), key=itemgetter(1))[-1 - OUTLIERS :]
        self._peaks_pa = dict(highest)
        return highest[0][1] if len(highest) > OUTLIERS else 0.0


def _grown(end: float, value: float) -> float:
    return rounded_up(value) if math.isfinite(value) and value > end else end


def _round_in(unit: Unit, si: float) -> float:
    """`si` rounded up to a round number in a unit."""
    return rounded_up(unit.from_si(si)) / unit.from_si(1.0)
