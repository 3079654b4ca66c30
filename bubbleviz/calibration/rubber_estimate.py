"""λ and gauge pressure with their intervals, or that the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.press_fit import HeldPress
from bubbleviz.calibration.rest_frames import Samples
from bubbleviz.calibration.rubber_fit import LARGEST_Q, SMALLEST_Q, RubberFit, Vented, fit_rubber
from bubbleviz.calibration.tension import Quantity, TensionEstimate
from bubbleviz.errors import InputError, SolveError
from bubbleviz.membrane import MembraneMesh
from bubbleviz.recordings import error_of_mean
from bubbleviz.result import HALF_95
from bubbleviz.sensor import WEATHER_SIGMA_PA
from bubbleviz.sensor_model import SensorModel

_UNEXPLAINED = 0.25  # share of the change of range that rubber may leave unexplained


@dataclass(frozen=True)
class RubberEstimate:
    """What inflation levels, or a press, tell of the rubber."""

    prestretch: Quantity | None  # λ; None: not determined
    # gauge pressure of the reference surface, Pa; None: not determined, the sensor file's stands
    gauge: Quantity | None
    # by levels and by a press it is weighed with the sensor file's
    gauge_from: Literal["vented", "levels", "press", "given"]
    fit: RubberFit | None  # None where neither a level nor a press was of use
    levels: tuple[str, ...] = ()  # names of the recordings
    press: str = ""  # that of the press, where it was asked; empty where not
    vented: str = ""  # that of the open chamber; empty where there is none
    why_not: str = ""  # why λ is not determined; empty where it is
    # (Quantity, Quantity) or None, the gauge pressure by the levels or the press alone, and by the
    # sensor file, Pa; None where it was not weighed
    both: tuple[Quantity, Quantity] | None = None

    @property
    def contradicts_file(self) -> bool:
        """Whether the intervals of the gauge pressure by shapes and by the file do not meet."""
        if self.both is None:
            return False
        shapes, file = self.both
        return shapes.low > file.high or shapes.high < file.low

    @property
    def told_by(self) -> Literal["press", "levels"]:
        """What was asked."""
        return "press" if self.press else "levels"

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        return {
            "vented": f"the open chamber of {self.vented}",
            "levels": f"{self._shapes}; the sensor file",
            "press": f"{self._shapes}; the sensor file",
            "given": "the sensor file's atmospheric pressure",
        }[self.gauge_from]

    @property
    def prestretch_rests_on(self) -> str:
        """What λ comes from, in words."""
        if self.gauge_from in ("levels", "press"):
            return self._shapes
        return f"{self._shapes}; the gauge pressure by {self.gauge_rests_on}"

    @property
    def _shapes(self) -> str:
        if self.levels:
            return f"inflation levels: {', '.join(self.levels)}"
        return f"the press in {self.press}"


def estimate_rubber(
    model: SensorModel,  # as identified from `samples`
    samples: Samples,  # of the reference surface
    # for the gauge pressure by the sensor file's atmospheric pressure, or by the open chamber's
    tension: TensionEstimate,
    levels: Sequence[Samples],  # of the untouched sensor at other pressures
    vented: Vented | None = None,
    held: Samples | None = None,  # of a press, which is asked where there are no levels
    *,
    # standard deviation of the gauge pressure by the sensor file, Pa; the weather's where None
    gauge_sigma_pa: float | None,
    other_mesh: MembraneMesh,  # as of `fit_rubber`
) -> RubberEstimate | None:
    """λ, and where the chamber was not opened the gauge pressure, from levels or from a press.

    Returns
    -------
    RubberEstimate or None
        None where there are no levels, no press and no open chamber.
    """
    if vented is None and not levels and held is None:
        return None
    names = tuple(each.source_name for each in levels)
    press = "" if held is None or levels else held.source_name
    known = RubberEstimate(None, None, "given", None, names, press)
    gas = samples.gas_pressure_pa
    if vented is not None:
        if gas is None:
            raise InputError(
                f"{samples.source_name}: no gas pressure, so that {vented.source_name} says nothing"
                " of its gauge pressure; leave --vented out, or record the pressure"
            )
        sigma = float(np.hypot(vented.sigma_pa, error_of_mean(gas)))
        gauge = Quantity.normal(tension.gauge_pressure_pa, sigma)
        known = replace(known, gauge=gauge, gauge_from="vented", vented=vented.source_name)
    vented_sigma = None if known.gauge is None else known.gauge.sigma
    told = tension.gauge_pressure_pa, vented_sigma, tension.tension.sigma / tension.tension.value
    try:
        if levels:
            fit = _of_levels(model, samples, levels, other_mesh, *told)
        elif held is not None:
            fit = HeldPress(model, samples, held).fit(*told)
        else:
            return replace(known, why_not="no inflation level was recorded")
    except (InputError, SolveError) as error:
        return replace(known, why_not=str(error))
    if vented is not None:
        return _judged(fit, known, known)
    by_file = Quantity.normal(tension.gauge_pressure_pa, gauge_sigma_pa or WEATHER_SIGMA_PA)
    return _weighed(fit, by_file, known)


def _of_levels(
    model: SensorModel,
    samples: Samples,
    levels: Sequence[Samples],
    other_mesh: MembraneMesh,
    gauge_pa: float,
    sigma_pa: float | None,
    stress_sigma: float,
) -> RubberFit:
    if any(each.gas_pressure_pa is None for each in (samples, *levels)):
        raise InputError("not every level has its gas pressure recorded")
    mask = np.ones(samples.depth_m.shape[1:], bool) if model.pixels is None else model.pixels.mask
    where = samples, model.mesh, other_mesh, model.camera, mask, levels
    return fit_rubber(*where, gauge_pa, sigma_pa, stress_sigma)


def _weighed(fit: RubberFit, by_file: Quantity, known: RubberEstimate) -> RubberEstimate:
    """Gauge pressure by the shapes and by the sensor file, each by its variance, and λ under it.

    What differs by more than both deviations leave widens that of the mean by as much, as the
    Particle Data Group does. Where not even the intervals meet one of them is wrong, and the
    interval holds both.
    """
    by_shapes = Quantity.of(fit.gauge_pressure_pa, fit.gauge_errors_pa)
    found = replace(known, gauge_from=known.told_by, both=(by_shapes, by_file))
    spread = float(np.hypot(by_shapes.sigma, by_file.sigma))
    apart = by_shapes.value - by_file.value
    gauge = by_file.value + (by_file.sigma / spread) ** 2 * apart
    sigma = by_shapes.sigma * by_file.sigma / spread * max(1.0, abs(apart) / spread)
    if found.contradicts_file:
        sigma = max(sigma, *(abs(each.value - gauge) / HALF_95 for each in (by_shapes, by_file)))
    found = replace(found, gauge=Quantity.normal(gauge, sigma))
    return _judged(fit, found, known)


def _judged(fit: RubberFit, found: RubberEstimate, before: RubberEstimate) -> RubberEstimate:
    """What was found with its λ, or what was known before and why nothing was found.

    Whether λ is determined is asked at the gauge pressure that was found; its interval then holds
    that one's deviation, as far as there is rubber.
    """
    if fit.rms_m > _UNEXPLAINED * fit.change_rms_m:
        why = (
            f"rubber of this shape misses by {1e3 * fit.rms_m:.2g} mm what changes by"
            f" {1e3 * fit.change_rms_m:.2g} mm"
        )
        return replace(before, fit=fit, why_not=why)
    held = fit
    if found.both is not None and (gauge := found.gauge) is not None:
        held, fit = fit.under(gauge.value, 0.0), fit.under(gauge.value, gauge.sigma)
    q = Quantity.of(held.q, held.q_errors)
    if not 0.0 < q.low <= q.high < 1.0:
        what = "press is too shallow" if found.press else "levels differ too little"
        why = f"the {what}, or constant tension explains as much"
        return replace(found, fit=fit, why_not=why)
    wide = Quantity.of(fit.q, fit.q_errors)
    low, high = max(wide.low, SMALLEST_Q), min(wide.high, LARGEST_Q)
    prestretch = Quantity(*(x ** (-1.0 / 6.0) for x in (q.value, high, low)))
    return replace(found, fit=fit, prestretch=prestretch)
