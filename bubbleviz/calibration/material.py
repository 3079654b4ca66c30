"""Pre-stretch and gauge pressure from inflation levels, a press and the open chamber."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.rest_frames import FrameSamples, collect
from bubbleviz.calibration.rubber_problem import LARGEST_Q, SMALLEST_Q, Fit, RubberProblem
from bubbleviz.calibration.tension import Quantity
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import LAG, MIN_FRAMES, FrameSource, error_of_mean, robust_sigma
from bubbleviz.result import HALF_95
from bubbleviz.sensor import WEATHER_SIGMA_PA, Sensor
from bubbleviz.wording import count_of

_MAX_UNEXPLAINED = 0.25  # largest share of the change of range that the rubber model may not fit


@dataclass(frozen=True)
class RubberEstimate:
    """Pre-stretch and gauge pressure, and the data that they come from."""

    prestretch: Quantity | None  # λ; None: not determined
    # gauge pressure of the reference surface, Pa; None: not determined, the sensor file's is used
    gauge: Quantity | None
    # from levels or a press: weighted mean with the sensor file's
    gauge_from: Literal["vented", "levels", "press", "given"]
    shapes_text: str = ""  # the recordings of levels or press, for reports
    shapes_kind: Literal["press", "levels"] = "levels"
    vented: str = ""  # name of the recording of the open chamber; empty where there is none
    why_not: str = ""  # why λ is not determined; empty where it is
    # gauge pressure from the shapes alone, and from the sensor file, Pa; None: no weighted mean
    gauge_candidates: tuple[Quantity, Quantity] | None = None
    rises_pa: tuple[float, ...] = ()  # gas pressure of every shape over that at rest, Pa
    # robust rms of the changes of range from rest, and of the residuals of the rubber model, m
    change_rms_m: float = np.nan
    unexplained_rms_m: float = np.nan

    @property
    def contradicts_file(self) -> bool:
        """Whether gauge pressures from shapes and file differ by more than their intervals."""
        if self.gauge_candidates is None:
            return False
        shapes, file = self.gauge_candidates
        return abs(shapes.value - file.value) > np.hypot(shapes.half_width, file.half_width)

    @property
    def gauge_source(self) -> str:
        """Source of the gauge pressure, as text."""
        if self.gauge_from == "vented":
            return f"the open-chamber recording {self.vented}"
        if self.gauge_from == "given":
            return "the sensor file"
        return f"{self.shapes_text}; the sensor file"

    @property
    def prestretch_source(self) -> str:
        """Source of λ, as text."""
        if self.gauge_from in ("levels", "press"):
            return self.shapes_text
        return f"{self.shapes_text}; the gauge pressure from {self.gauge_source}"


@dataclass(frozen=True)
class Vented:
    """Gas pressure of the open chamber, with the same sensor offset as when it is closed."""

    source_name: str
    pressure_pa: float  # absolute, Pa
    sigma_pa: float  # standard error, Pa

    @classmethod
    def measure(cls, source: FrameSource) -> Vented:
        """Mean over all frames of a recording.

        Raises InputError: fewer than five frames with a gas pressure.
        """
        fewest = 5  # for a mean with a standard error; chosen
        values = [source[k].gas_pressure_pa for k in range(len(source))]
        known = np.array([value for value in values if value is not None])
        if len(known) < fewest:
            raise InputError(
                f"{source.name}: only {count_of(len(known), 'frame')} with a gas pressure; record "
                f"{fewest} or more with the chamber open, or leave --vented out"
            )
        return cls(source.name, float(np.mean(known)), error_of_mean(known))

    def set_in(self, sensor: Sensor) -> Sensor:
        section = sensor.pneumatics.model_copy(
            update={
                "atmospheric_pressure_pa": round(self.pressure_pa, 1),
                "gauge_sigma_pa": None,  # belongs to the sensor file's gauge pressure
            }
        )
        return sensor.model_copy(update={"pneumatics": section})


_HOLD_SHARE = 0.9  # of the largest rise of the gas pressure: above it, a press counts as held
_MIN_RISE = 10.0  # of the gas pressure by a press, in standard deviations


def press_hold_frames(
    source: FrameSource, samples: FrameSamples, progress: Progress = quiet
) -> list[int]:
    """Frames after the contact-free ones with a gas pressure near its maximum.

    Empty where there is no gas pressure, or no press that raises it by ten times its noise.
    """
    free = samples.gas_pressure_pa
    if free is None:
        return []
    rest = float(np.median(free))
    later = range(max(samples.frames) + 1, len(source))
    rises = []
    for k in later:
        value = source[k].gas_pressure_pa
        rises.append(np.nan if value is None else value - rest)
        progress("finding the press", (k - later.start) / len(later))
    rise = np.array(rises)
    if not np.isfinite(rise).any() or np.nanmax(rise) < _MIN_RISE * max(robust_sigma(free), 1e-9):
        return []
    return [later[k] for k in np.flatnonzero(rise > _HOLD_SHARE * np.nanmax(rise))]


def collect_press(
    source: FrameSource, found: Identification, progress: Progress = quiet
) -> FrameSamples | None:
    """Frames of a press held after the contact-free frames, with gas pressure; None without one.

    The first frames are left out: a camera's temporal filter still mixes earlier images into them.
    """
    hold = dict.fromkeys(press_hold_frames(source, found.samples, progress))
    frames = [k for k in hold if k - LAG in hold]
    return collect(source, found.given, frames, progress) if len(frames) >= MIN_FRAMES else None


def with_rubber(
    # with the open chamber's atmospheric pressure, where that is given
    found: Identification,
    levels: Sequence[FrameSamples],  # of the untouched sensor at other pressures
    vented: Vented | None = None,
    press: FrameSamples | None = None,  # used where there are no levels
    # standard deviation of gas pressure differences between recordings, Pa; None: of a typical
    # pressure sensor
    level_sigma_pa: float | None = None,
) -> Identification:
    """Identification with λ and gauge pressure from levels, a press and the open chamber.

    Raises InputError: an open chamber was recorded, but not the gas pressure of the inflated
    sensor.
    """
    shapes = levels or ([] if press is None else [press])
    if vented is None and not shapes:
        return found
    rubber = _estimate(found, shapes, vented, level_sigma_pa, pressed=not levels)
    tension = found.tension if rubber.gauge is None else found.tension.under(rubber.gauge)
    return replace(found, tension=tension, rubber=rubber)


def _estimate(
    found: Identification,
    shapes: Sequence[FrameSamples],  # levels, or a press
    vented: Vented | None,
    level_sigma_pa: float | None,
    *,
    pressed: bool,
) -> RubberEstimate:
    names = ", ".join(each.source_name for each in shapes)
    text = (f"the press in {names}" if pressed else f"inflation levels: {names}") if shapes else ""
    known = RubberEstimate(None, None, "given", text, "press" if pressed else "levels")
    samples, tension = found.samples, found.tension
    gauge, gas = tension.gauge_pressure_pa, samples.gas_pressure_pa
    sigma = tension.gauge_sigma_pa or WEATHER_SIGMA_PA
    if vented is not None:
        if gas is None:
            raise InputError(
                f"{samples.source_name}: not every contact-free frame has a gas pressure, so "
                f"{vented.source_name} does not determine the gauge pressure; record it in every "
                "frame, or leave --vented out"
            )
        sigma = float(np.hypot(vented.sigma_pa, error_of_mean(gas)))
        name, by_chamber = vented.source_name, Quantity.normal(gauge, sigma)
        known = replace(known, gauge=by_chamber, gauge_from="vented", vented=name)
    if not shapes:
        return replace(known, why_not="neither levels nor a held press were used")
    relative = tension.of_shape.sigma / tension.of_shape.value
    given = found.model, samples, shapes, found.surfaces.other_mesh, gauge, relative
    try:
        problem = RubberProblem(*given, level_sigma_pa, pressed=pressed)
        alone = problem.fit()
        fit = problem.refit(alone, sigma / gauge)
    except InputError as error:
        return replace(known, why_not=str(error))
    known = replace(
        known,
        rises_pa=problem.rises_pa,
        change_rms_m=problem.change_rms_m,
        unexplained_rms_m=problem.unexplained_rms_m(fit.vector),
    )
    return _with_fit(alone, fit, Quantity.normal(gauge, sigma), known)


def _with_fit(
    alone: Fit,  # from the shapes alone
    fit: Fit,  # from the shapes and the gauge pressure that is known otherwise
    by_file: Quantity,
    known: RubberEstimate,
) -> RubberEstimate:
    """Estimate with λ and gauge pressure of the fit, or the reason why λ is not determined.

    Model errors are the same in every recording and may have the sign of the file's error. So in
    the weighted mean the two errors add linearly, not in squares. A difference of the two gauge
    pressures beyond their deviations widens the interval as the Particle Data Group does. Beyond
    their 95 % intervals one of them is wrong, and the interval covers both of theirs.
    λ counts as determined by its interval at the gauge pressure found.
    """
    change, unexplained = known.change_rms_m, known.unexplained_rms_m
    if unexplained > _MAX_UNEXPLAINED * change:
        misfit = f"misfit {1e3 * unexplained:.2g} mm of a change of {1e3 * change:.2g} mm"
        return replace(known, why_not=f"no rubber of this shape fits: {misfit}")
    covariance, found = fit.covariance, known
    if known.gauge is None:
        by_shapes, mean = (_gauge(each, by_file.value) for each in (alone, fit))
        candidates = by_shapes, by_file
        found = replace(known, gauge_from=known.shapes_kind, gauge_candidates=candidates)
        spread = np.hypot(by_shapes.sigma, by_file.sigma)
        apart = abs(by_shapes.value - by_file.value) / spread
        mean_sigma = by_shapes.sigma * by_file.sigma / spread
        linear_sum = (by_shapes.sigma + by_file.sigma) / spread
        sigma = max(mean.sigma, float(mean_sigma * max(linear_sum, apart)))
        if found.contradicts_file:
            ends = (by_shapes.low, by_shapes.high, by_file.low, by_file.high)
            sigma = max(sigma, *(abs(end - mean.value) / HALF_95 for end in ends))
        found = replace(found, gauge=Quantity.normal(mean.value, sigma))
        covariance = covariance * (sigma / mean.sigma) ** 2
    # variance of q at a fixed gauge pressure
    conditional = fit.covariance[0, 0] - fit.covariance[0, 1] ** 2 / fit.covariance[1, 1]
    q = Quantity.normal(float(fit.vector[0]), float(np.sqrt(max(conditional, 0.0))))
    if not 0.0 < q.low <= q.high < 1.0:
        pressed = found.shapes_kind == "press"
        what = "press is too shallow" if pressed else "levels differ too little"
        why = f"the {what}, or constant tension fits as well"
        return replace(found, why_not=why)
    wide = Quantity.normal(float(fit.vector[0]), float(np.sqrt(covariance[0, 0])))
    low, high = max(wide.low, SMALLEST_Q), min(wide.high, LARGEST_Q)
    return replace(found, prestretch=Quantity(*(x ** (-1.0 / 6.0) for x in (q.value, high, low))))


def _gauge(fit: Fit, start_pa: float) -> Quantity:
    """Gauge pressure of a fit from its initial value, Pa."""
    return Quantity.normal(
        start_pa * float(fit.vector[1]), start_pa * float(np.sqrt(fit.covariance[1, 1]))
    )
