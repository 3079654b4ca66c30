"""λ and gauge pressure with their intervals, or that the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.rest.noise_correlation import error_of_mean
from bubbleviz.calibration.rest.rest_frames import Samples
from bubbleviz.calibration.rubber.press_fit import HeldPress
from bubbleviz.calibration.rubber.rubber_fit import RubberFit, fit_rubber
from bubbleviz.calibration.rubber.vented import Vented
from bubbleviz.calibration.tension.tension_estimate import Quantity, TensionEstimate
from bubbleviz.errors import InputError
from bubbleviz.sensor_model import SensorModel

_WIDEST = 0.2
"""Half-width of the gauge pressure's interval over itself from which on it is called not
determined: force is as wrong as the gauge pressure."""
_NORMAL = 1.96
"""Half of a 95 % interval over σ."""
_UNEXPLAINED = 0.25
"""Share of the change of range that rubber may leave unexplained."""


@dataclass(frozen=True)
class RubberEstimate:
    """What inflation levels, or a press, tell of the rubber.

    Attributes
    ----------
    prestretch : Quantity or None
        λ; None: not determined.
    gauge : Quantity or None
        Gauge pressure of the reference surface, Pa; None: not determined, the sensor file's stands.
    gauge_from : {"vented", "levels", "press", "given"}
    fit : RubberFit or None
        None where neither a level nor a press was of use.
    levels : tuple of str
        Names of the recordings.
    press : str
        That of the press, where it was asked; empty where not.
    vented : str
        That of the open chamber; empty where there is none.
    why_not : str
        Why λ is not determined; empty where it is.
    """

    prestretch: Quantity | None
    gauge: Quantity | None
    gauge_from: Literal["vented", "levels", "press", "given"]
    fit: RubberFit | None
    levels: tuple[str, ...] = ()
    press: str = ""
    vented: str = ""
    why_not: str = ""

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        return {
            "vented": f"the open chamber of {self.vented}",
            "levels": self._shapes,
            "press": self._shapes,
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
    model: SensorModel,
    samples: Samples,
    tension: TensionEstimate,
    levels: Sequence[Samples],
    vented: Vented | None = None,
    held: Samples | None = None,
) -> RubberEstimate | None:
    """λ, and where the chamber was not opened the gauge pressure, from levels or from a press.

    Parameters
    ----------
    model : SensorModel
        As identified from `samples`.
    samples : Samples
        Of the reference surface.
    tension : TensionEstimate
        For the gauge pressure by the sensor file's atmospheric pressure, or by the open chamber's.
    levels : sequence of Samples
        Of the untouched sensor at other pressures.
    vented : Vented, optional
    held : Samples, optional
        Of a press, which is asked where there are no levels.

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
    gas, sigma = samples.gas_pressure_pa, None
    if vented is not None:
        if gas is None:
            raise InputError(
                f"{samples.source_name}: no gas pressure, so that {vented.source_name} says nothing"
                " of its gauge pressure; leave --vented out, or record the pressure"
            )
        sigma = float(np.hypot(vented.sigma_pa, error_of_mean(gas)))
        gauge = Quantity.normal(tension.gauge_pressure_pa, sigma)
        known = replace(known, gauge=gauge, gauge_from="vented", vented=vented.source_name)
    try:
        if levels:
            return _by_levels(model, samples, tension, levels, sigma, known)
        if held is not None:
            return _by_press(HeldPress(model, samples, held), tension, sigma, known)
    except InputError as error:
        return replace(known, why_not=str(error))
    return replace(known, why_not="no inflation level was recorded")


def _by_levels(
    model: SensorModel,
    samples: Samples,
    tension: TensionEstimate,
    levels: Sequence[Samples],
    gauge_sigma_pa: float | None,
    known: RubberEstimate,
) -> RubberEstimate:
    if any(each.gas_pressure_pa is None for each in (samples, *levels)):
        return replace(known, why_not="not every level has its gas pressure recorded")
    mask = np.ones(samples.depth_m.shape[1:], bool) if model.pixels is None else model.pixels.mask
    where = samples, model.mesh, model.camera, mask, levels, tension.gauge_pressure_pa
    fit = fit_rubber(*where, gauge_sigma_pa, _relative(tension))
    if gauge_sigma_pa is None:
        free = Quantity.of(fit.gauge_pressure_pa, fit.gauge_errors_pa)
        if free.half_width < _WIDEST * free.value:
            return _judged(fit, replace(known, gauge=free, gauge_from="levels"), known)
        fit = fit_rubber(*where, 0.0, _relative(tension))
    return _judged(fit, known, known)


def _by_press(
    press: HeldPress,
    tension: TensionEstimate,
    gauge_sigma_pa: float | None,
    known: RubberEstimate,
) -> RubberEstimate:
    fit = press.fit(tension.gauge_pressure_pa, gauge_sigma_pa, _relative(tension))
    if gauge_sigma_pa is not None:
        return _judged(fit, known, known)
    gauge = Quantity.of(fit.gauge_pressure_pa, fit.gauge_errors_pa)
    if gauge.half_width < _WIDEST * gauge.value:
        return _judged(fit, replace(known, gauge=gauge, gauge_from="press"), known)
    return replace(
        known,
        fit=fit,
        why_not=f"the press leaves the gauge pressure open between {gauge.low:.0f} and"
        f" {gauge.high:.0f} Pa, and λ with it",
    )


def _relative(tension: TensionEstimate) -> float:
    """Relative standard deviation of γ0, as of the stress at rest."""
    return tension.tension.half_width / tension.tension.value / _NORMAL


def _judged(fit: RubberFit, found: RubberEstimate, before: RubberEstimate) -> RubberEstimate:
    """What was found with its λ, or what was known before and why nothing was found."""
    q = Quantity.of(fit.q, fit.q_errors)
    if fit.rms_m > _UNEXPLAINED * fit.change_rms_m:
        why = (
            f"rubber of this shape misses by {1e3 * fit.rms_m:.2g} mm what changes by"
            f" {1e3 * fit.change_rms_m:.2g} mm"
        )
        return replace(before, fit=fit, why_not=why)
    if not 0.0 < q.low <= q.high < 1.0:
        what = "press is too shallow" if found.press else "levels differ too little"
        why = f"the {what}, or constant tension explains as much"
        return replace(found, fit=fit, why_not=why)
    prestretch = Quantity(*(x ** (-1.0 / 6.0) for x in (q.value, q.high, q.low)))
    return replace(found, fit=fit, prestretch=prestretch)
