"""λ and gauge pressure with their intervals, or that the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.rest.noise_correlation import error_of_mean
from bubbleviz.calibration.rest.rest_frames import Samples
from bubbleviz.calibration.rubber.rubber_fit import RubberFit, fit_rubber
from bubbleviz.calibration.rubber.vented import Vented
from bubbleviz.calibration.surface.reference_surface import Surfaces
from bubbleviz.calibration.tension.tension_estimate import Quantity, TensionEstimate
from bubbleviz.errors import InputError

_WIDEST = 0.2
"""Half-width of the gauge pressure's interval over itself from which on it is called not
determined: force is as wrong as the gauge pressure."""
_NORMAL = 1.96
"""Half of a 95 % interval over σ."""
_UNEXPLAINED = 0.25
"""Share of the levels' change of range that rubber may leave unexplained."""


@dataclass(frozen=True)
class RubberEstimate:
    """What inflation tells of the rubber.

    Attributes
    ----------
    prestretch : Quantity or None
        λ; None: not determined.
    gauge : Quantity or None
        Gauge pressure of the reference surface, Pa; None: not determined, the sensor file's stands.
    gauge_from : {"vented", "levels", "given"}
    fit : RubberFit or None
        None where no level was of use.
    levels : tuple of str
        Names of the recordings.
    vented : str
        That of the open chamber; empty where there is none.
    why_not : str
        Why λ is not determined; empty where it is.
    """

    prestretch: Quantity | None
    gauge: Quantity | None
    gauge_from: Literal["vented", "levels", "given"]
    fit: RubberFit | None
    levels: tuple[str, ...] = ()
    vented: str = ""
    why_not: str = ""

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        return {
            "vented": f"the open chamber of {self.vented}",
            "levels": f"inflation levels: {', '.join(self.levels)}",
            "given": "the sensor file's atmospheric pressure",
        }[self.gauge_from]

    @property
    def prestretch_rests_on(self) -> str:
        """What λ comes from, in words."""
        levels = f"inflation levels: {', '.join(self.levels)}"
        if self.gauge_from == "levels":
            return levels
        return f"{levels}; the gauge pressure by {self.gauge_rests_on}"


def estimate_rubber(
    samples: Samples,
    surfaces: Surfaces,
    mask: np.ndarray,
    tension: TensionEstimate,
    levels: Sequence[Samples],
    vented: Vented | None = None,
) -> RubberEstimate | None:
    """λ, and where the chamber was not opened the gauge pressure, from inflation levels.

    Parameters
    ----------
    samples, surfaces
        Of the reference surface.
    mask : (H, W) bool array
        Pixels in use.
    tension : TensionEstimate
        For the gauge pressure by the sensor file's atmospheric pressure, or by the open chamber's.
    levels : sequence of Samples
        Of the untouched sensor at other pressures.
    vented : Vented, optional

    Returns
    -------
    RubberEstimate or None
        None where there are neither levels nor an open chamber.
    """
    if vented is None and not levels:
        return None
    names = tuple(each.source_name for each in levels)
    known = RubberEstimate(None, None, "given", None, names)
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
    if not levels:
        return replace(known, why_not="no inflation level was recorded")
    if any(each.gas_pressure_pa is None for each in (samples, *levels)):
        return replace(known, why_not="not every level has its gas pressure recorded")
    where = samples, surfaces.mesh, surfaces.camera, mask, levels, tension.gauge_pressure_pa
    relative = tension.tension.half_width / tension.tension.value / _NORMAL
    try:
        fit = fit_rubber(*where, sigma, relative)
        free = Quantity.of(fit.gauge_pressure_pa, fit.gauge_errors_pa)
        if vented is None and free.half_width < _WIDEST * free.value:
            return _judged(fit, replace(known, gauge=free, gauge_from="levels"), known)
        if vented is None:
            fit = fit_rubber(*where, 0.0, relative)
    except InputError as error:
        return replace(known, why_not=str(error))
    return _judged(fit, known, known)


def _judged(fit: RubberFit, found: RubberEstimate, before: RubberEstimate) -> RubberEstimate:
    """What was found with its λ, or what was known before and why nothing was found."""
    q = Quantity.of(fit.q, fit.q_errors)
    if fit.rms_m > _UNEXPLAINED * fit.change_rms_m:
        why = (
            f"rubber of this shape misses the levels by {1e3 * fit.rms_m:.2g} mm, where they differ"
            f" by {1e3 * fit.change_rms_m:.2g} mm"
        )
        return replace(before, fit=fit, why_not=why)
    if not 0.0 < q.low <= q.high < 1.0:
        why = "the levels differ too little, or constant tension explains them as well"
        return replace(found, fit=fit, why_not=why)
    prestretch = Quantity(*(x ** (-1.0 / 6.0) for x in (q.value, q.high, q.low)))
    return replace(found, fit=fit, prestretch=prestretch)
