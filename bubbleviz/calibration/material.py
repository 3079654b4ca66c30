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
from bubbleviz.recordings import LAG, MIN_FRAMES, FrameSource, robust_sigma
from bubbleviz.result import HALF_95
from bubbleviz.sensor import Sensor

_MAX_UNEXPLAINED = 0.25  # largest share of the change of range that the rubber model may not fit


@dataclass(frozen=True)
class RubberEstimate:
    """Pre-stretch and gauge pressure, and the data that they come from."""

    prestretch: Quantity | None = None  # λ; None: not determined
    # gauge pressure of the reference surface, Pa, weighted mean of that from the shapes and the
    # sensor file's; None: known by the open chamber, or not determined
    gauge: Quantity | None = None
    shapes_kind: Literal["press", "levels"] = "levels"
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
    source: FrameSource, samples: FrameSamples, sensor: Sensor, progress: Progress = quiet
) -> FrameSamples | None:
    """Frames of a press held after the contact-free frames, with gas pressure; None without one.

    The first frames are left out: a camera's temporal filter still mixes earlier images into them.
    """
    hold = dict.fromkeys(press_hold_frames(source, samples, progress))
    frames = [k for k in hold if k - LAG in hold]
    return collect(source, sensor, frames, progress) if len(frames) >= MIN_FRAMES else None


def with_rubber(
    found: Identification,
    levels: Sequence[FrameSamples],  # of the untouched sensor at other pressures
    press: FrameSamples | None = None,  # used where there are no levels
    # standard deviation of gas pressure differences between recordings, Pa; None: of a typical
    # pressure sensor
    level_sigma_pa: float | None = None,
) -> Identification:
    """Identification with λ and gauge pressure from levels or a press."""
    shapes = levels or ([] if press is None else [press])
    if found.vented is None and not shapes:
        return found
    rubber = _estimate(found, shapes, level_sigma_pa, pressed=not levels)
    tension = found.tension if rubber.gauge is None else found.tension.under(rubber.gauge)
    return replace(found, tension=tension, rubber=rubber)


def _estimate(
    found: Identification,
    shapes: Sequence[FrameSamples],  # levels, or a press
    level_sigma_pa: float | None,
    *,
    pressed: bool,
) -> RubberEstimate:
    if not shapes:
        return RubberEstimate(why_not="neither levels nor a held press were used")
    names = ", ".join(each.source_name for each in shapes)
    source = f"the press in {names}" if pressed else f"inflation levels: {names}"
    known, gauge = RubberEstimate(shapes_kind="press" if pressed else "levels"), found.tension.gauge
    try:
        problem = RubberProblem(found, shapes, level_sigma_pa, pressed=pressed)
        alone = problem.fit()
        fit = problem.refit(alone, gauge.sigma / gauge.value)
    except InputError as error:
        return replace(known, why_not=str(error))
    known = replace(
        known,
        rises_pa=problem.rises_pa,
        change_rms_m=problem.change_rms_m,
        unexplained_rms_m=problem.unexplained_rms_m(fit.vector),
    )
    if found.vented is None:
        return _with_fit(alone, fit, gauge, known, source)
    return _with_fit(alone, fit, None, known, f"{source}; the gauge pressure from {gauge.source}")


def _with_fit(
    alone: Fit,  # from the shapes alone
    fit: Fit,  # from the shapes and the gauge pressure that is known otherwise
    by_file: Quantity | None,  # gauge pressure in the sensor file, Pa; None: the chamber was opened
    known: RubberEstimate,
    source: str,  # of λ, for reports
) -> RubberEstimate:
    """Estimate with λ and gauge pressure of the fit, or the reason why λ is not determined.

    Model errors are the same in every recording and may have the sign of the file's error. So in
    the weighted mean the two errors add linearly, not in squares. A difference of the two gauge
    pressures beyond their deviations widens the interval as the Particle Data Group does. Beyond
    their 95 % intervals one of them is wrong, and the interval covers both of theirs.
    λ counts as determined unless its interval at the gauge pressure found holds 1. One that holds
    constant tension ends at the largest λ: rubber of the best λ is nearer to the truth than that.
    """
    change, unexplained = known.change_rms_m, known.unexplained_rms_m
    if unexplained > _MAX_UNEXPLAINED * change:
        misfit = f"misfit {1e3 * unexplained:.2g} mm rms of a change of {1e3 * change:.2g} mm rms"
        return replace(known, why_not=f"no rubber of this shape at rest fits: {misfit}")
    covariance, found = fit.covariance, known
    if by_file is not None:
        by_shapes, mean = (_gauge(each, by_file.value, source) for each in (alone, fit))
        candidates = by_shapes, by_file
        found = replace(known, gauge_candidates=candidates)
        spread = np.hypot(by_shapes.sigma, by_file.sigma)
        apart = abs(by_shapes.value - by_file.value) / spread
        mean_sigma = by_shapes.sigma * by_file.sigma / spread
        linear_sum = (by_shapes.sigma + by_file.sigma) / spread
        sigma = max(mean.sigma, float(mean_sigma * max(linear_sum, apart)))
        if found.contradicts_file:
            ends = (by_shapes.low, by_shapes.high, by_file.low, by_file.high)
            sigma = max(sigma, *(abs(end - mean.value) / HALF_95 for end in ends))
        both = f"{source}; {by_file.source}"
        found = replace(found, gauge=Quantity.normal(mean.value, sigma, both))
        covariance = covariance * (sigma / mean.sigma) ** 2
    if fit.vector[0] < 1.01 * SMALLEST_Q:
        why = f"the {found.shapes_kind} fit a constant tension best"
        return replace(found, why_not=why)
    # variance of q at a fixed gauge pressure
    conditional = fit.covariance[0, 0] - fit.covariance[0, 1] ** 2 / fit.covariance[1, 1]
    q = Quantity.normal(float(fit.vector[0]), float(np.sqrt(max(conditional, 0.0))))
    if q.high >= 1.0:
        return replace(found, why_not=f"λ = 1 fits the {found.shapes_kind} as well")
    wide = Quantity.normal(float(fit.vector[0]), float(np.sqrt(covariance[0, 0])))
    low, high = max(wide.low, SMALLEST_Q), min(wide.high, LARGEST_Q)
    value, low, high = (x ** (-1.0 / 6.0) for x in (q.value, high, low))
    return replace(found, prestretch=Quantity(value, low, high, source))


def _gauge(fit: Fit, start_pa: float, source: str) -> Quantity:
    """Gauge pressure of a fit from its initial value, Pa."""
    value, sigma = float(fit.vector[1]), float(np.sqrt(fit.covariance[1, 1]))
    return Quantity.normal(start_pa * value, start_pa * sigma, source)
