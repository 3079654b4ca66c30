"""Colour maps and colour ranges of the 3-D view."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib import colormaps

from bubbleviz.result import Result
from bubbleviz.sensor import Sensor
from bubbleviz_ui.model.frame_history import FrameHistory
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
    """Entries (256, 4) uint8: blue where measured nearer than modelled, pink where farther.

    `middle` is the colour of zero. Neither end is in the pressure map, or the green of a good
    result, so that they cannot be confused.
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


class Scales:
    """Scales of all sensors in the view: one for all frames, so that colours are comparable.

    They cover the frames computed so far except outliers, and of a live source the one shown. Ends
    are round numbers in the displayed units.
    """

    def __init__(self, units: Units) -> None:
        self._units, self._least_pa = units, 1e3
        self._shown: dict[object, tuple[FrameHistory, Result]] = {}

    def set_sensor(self, sensor: Sensor) -> None:
        """Set the sensor, whose gauge pressure gives the smallest scale."""
        self._least_pa = rounded_up(PRESSURE_SHARE * sensor.pneumatics.gauge_pressure_pa)

    def show(self, sensor_key: object, history: FrameHistory, result: Result) -> None:
        """Cover the frames of a sensor, of which one is shown."""
        self._shown[sensor_key] = history, result

    def forget(self, sensor_key: object) -> None:
        self._shown.pop(sensor_key, None)

    def of(self, settings: Settings) -> Ranges:
        """Current scales."""
        pressure_pa, residual_m, force_n = self._least_pa, SMALLEST_RESIDUAL_M, SMALLEST_FORCE_N
        for history, result in self._shown.values():
            seen, estimate = history.extremes, result.trusted_estimate
            pressure_pa = max(pressure_pa, seen.usual_peak_pa)
            if result.frame.arrival_ns and estimate is not None and estimate.status == "ok":
                pressure_pa = max(pressure_pa, float(estimate.contact_pressure_pa.max()))
            residual_m = max(residual_m, RESIDUAL_TIMES_RMS * seen.residual_m)
            force_n = max(force_n, seen.force_n)
        units = self._units
        return Ranges(
            settings.pressure_max_pa or _round_in(units.pressure, pressure_pa),
            settings.residual_max_m or _round_in(units.length, residual_m),
            rounded_up(force_n),
        )


def _round_in(unit: Unit, si: float) -> float:
    return rounded_up(unit.from_si(si)) / unit.from_si(1.0)
