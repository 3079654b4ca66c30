"""Pre-stretch and gauge pressure as inflation levels, a press and the open chamber tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bubbleviz.calibration.identification import Identification, pressures, rest_gauge
from bubbleviz.calibration.rest_frames import Samples, collect
from bubbleviz.calibration.rubber_problem import LARGEST_Q, SMALLEST_Q, Fit, RubberProblem
from bubbleviz.calibration.tension import Quantity
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import LAG, MIN_FRAMES, FrameSource, error_of_mean, robust_sigma
from bubbleviz.result import HALF_95
from bubbleviz.sensor import WEATHER_SIGMA_PA, Sensor
from bubbleviz.wording import count_of

_UNEXPLAINED = 0.25  # share of the change of range that rubber may leave unexplained


@dataclass(frozen=True)
class RubberEstimate:
    """What inflation levels, a press and the open chamber tell of the rubber."""

    prestretch: Quantity | None  # λ; None: not determined
    # gauge pressure of the reference surface, Pa; None: not determined, the sensor file's stands
    gauge: Quantity | None
    # by levels and by a press it is weighed with the sensor file's
    gauge_from: Literal["vented", "levels", "press", "given"]
    shapes: str = ""  # the recordings of levels or press, in words
    told_by: Literal["press", "levels"] = "levels"  # what these are
    vented: str = ""  # name of the recording of the open chamber; empty where there is none
    why_not: str = ""  # why λ is not determined; empty where it is
    # the gauge pressure by the shapes alone, and by the sensor file, Pa; None where not weighed
    both: tuple[Quantity, Quantity] | None = None
    rises_pa: tuple[float, ...] = ()  # pressure of every shape over that of the rest, Pa
    # robust rms of the changes of range, and of what the rubber leaves of them, m
    change_rms_m: float = np.nan
    unexplained_rms_m: float = np.nan

    @property
    def contradicts_file(self) -> bool:
        """Whether gauge pressures by shapes and by the file differ by more than both errors."""
        if self.both is None:
            return False
        shapes, file = self.both
        return abs(shapes.value - file.value) > np.hypot(shapes.half_width, file.half_width)

    @property
    def gauge_rests_on(self) -> str:
        """What the gauge pressure comes from, in words."""
        if self.gauge_from == "vented":
            return f"the open chamber of {self.vented}"
        if self.gauge_from == "given":
            return "the sensor file's atmospheric pressure"
        return f"{self.shapes}; the sensor file"

    @property
    def prestretch_rests_on(self) -> str:
        """What λ comes from, in words."""
        if self.gauge_from in ("levels", "press"):
            return self.shapes
        return f"{self.shapes}; the gauge pressure by {self.gauge_rests_on}"


@dataclass(frozen=True)
class Vented:
    """Gas pressure of the open chamber: an offset of the sensor is the same with it closed."""

    source_name: str
    pressure_pa: float  # absolute, Pa
    sigma_pa: float  # standard error, Pa

    @classmethod
    def measure(cls, source: FrameSource) -> Vented:
        """Mean over all frames of a recording.

        Raises InputError: fewer than five frames with a gas pressure.
        """
        fewest = 5  # whose mean and spread say something; chosen
        values = [source[k].gas_pressure_pa for k in range(len(source))]
        known = np.array([value for value in values if value is not None])
        if len(known) < fewest:
            raise InputError(
                f"{source.name}: {count_of(len(known), 'frame')} with a gas pressure; --vented"
                f" needs {fewest}: record the sensor with its chamber open"
            )
        return cls(source.name, float(np.mean(known)), error_of_mean(known))

    def set_in(self, sensor: Sensor) -> Sensor:
        section = sensor.pneumatics.model_copy(
            update={
                "atmospheric_pressure_pa": round(self.pressure_pa, 1),
                "gauge_sigma_pa": None,  # of a gauge pressure told by something else
            }
        )
        return sensor.model_copy(update={"pneumatics": section})


_HELD = 0.9  # share of the largest rise of the gas pressure from which on a press counts as held
_CLEAR = 10.0  # standard deviations of the gas pressure by which a press must move it


def held_frames(source: FrameSource, samples: Samples, progress: Progress = quiet) -> list[int]:
    """Frames after the contact-free ones in which the gas pressure is near its largest.

    None of them where there is no gas pressure, or no press that moves it ten times its noise.
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
    if not np.isfinite(rise).any() or np.nanmax(rise) < _CLEAR * max(robust_sigma(free), 1e-9):
        return []
    return [later[k] for k in np.flatnonzero(rise > _HELD * np.nanmax(rise))]


def collect_press(
    source: FrameSource, found: Identification, progress: Progress = quiet
) -> Samples | None:
    """Frames of a later press that is held and whose gas pressure is known; None without one.

    Those whose images a camera's temporal filter has cleared of what was before them.
    """
    held = dict.fromkeys(held_frames(source, found.samples, progress))
    frames = [k for k in held if k - LAG in held]
    return collect(source, found.given, frames, progress) if len(frames) >= MIN_FRAMES else None


def with_rubber(
    # from a sensor with the open chamber's atmospheric pressure, where that is given
    found: Identification,
    levels: Sequence[Samples],  # of the untouched sensor at other pressures
    vented: Vented | None = None,
    held: Samples | None = None,  # of a press, which is asked where there are no levels
    # standard deviation of a gas pressure beside that of another recording, Pa; a usual sensor's
    level_sigma_pa: float | None = None,
) -> Identification:
    """Identification with λ, and the gauge pressure, as levels, a press and open chamber tell.

    Raises InputError: an open chamber was recorded, but not the gas pressure of the inflated
    sensor.
    """
    seen = levels or ([] if held is None else [held])
    if vented is None and not seen:
        return found
    rubber = _estimate(found, seen, vented, level_sigma_pa, pressed=not levels)
    tension, sensor, section = found.tension, found.sensor, {}
    if rubber.gauge is not None:
        tension = tension.under(rubber.gauge)
        section = pressures(found.samples, tension, rubber.gauge.sigma)
    stretch = {}
    if rubber.prestretch is not None:
        stretch = {"prestretch": round(rubber.prestretch.value, 4)}
    update = {
        "membrane": sensor.membrane.model_copy(update=stretch),
        "pneumatics": sensor.pneumatics.model_copy(update=section),
    }
    return replace(found, sensor=sensor.model_copy(update=update), tension=tension, rubber=rubber)


def _estimate(
    found: Identification,
    seen: Sequence[Samples],  # levels, or a press
    vented: Vented | None,
    level_sigma_pa: float | None,
    *,
    pressed: bool,
) -> RubberEstimate:
    names = ", ".join(each.source_name for each in seen)
    words = (f"the press in {names}" if pressed else f"inflation levels: {names}") if seen else ""
    known = RubberEstimate(None, None, "given", words, "press" if pressed else "levels")
    samples, tension = found.samples, found.tension
    gauge, gas = tension.gauge_pressure_pa, samples.gas_pressure_pa
    sigma = rest_gauge(samples, found.given)[1] or WEATHER_SIGMA_PA
    if vented is not None:
        if gas is None:
            raise InputError(
                f"{samples.source_name}: no gas pressure, so {vented.source_name} does not "
                "determine the gauge pressure; leave --vented out, or record the pressure"
            )
        sigma = float(np.hypot(vented.sigma_pa, error_of_mean(gas)))
        name, by_chamber = vented.source_name, Quantity.normal(gauge, sigma)
        known = replace(known, gauge=by_chamber, gauge_from="vented", vented=name)
    if not seen:
        return replace(known, why_not="no inflation level was recorded")
    relative = tension.of_shape.sigma / tension.of_shape.value
    told = found.model, samples, seen, found.surfaces.other_mesh, gauge, relative
    try:
        problem = RubberProblem(*told, level_sigma_pa, pressed=pressed)
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
    return _judged(alone, fit, Quantity.normal(gauge, sigma), known)


def _judged(
    alone: Fit,  # by the shapes alone
    fit: Fit,  # with the gauge pressure that is known otherwise
    by_file: Quantity,
    known: RubberEstimate,
) -> RubberEstimate:
    """What was found with its λ, or what was known before and why nothing was found.

    What the shapes' model gets wrong is the same in every recording and may point the way the file
    is wrong, too: the two errors add up in the weighted mean, not their squares. Gauge pressures
    by the shapes and by the file that differ by more than both deviations leave widen that of the
    fit by as much, as the Particle Data Group does. Where they differ by more than their 95 %
    intervals explain one of them is wrong, and the interval holds both of theirs.
    Whether λ is determined is asked at the gauge pressure that was found.
    """
    changed, left = known.change_rms_m, known.unexplained_rms_m
    if left > _UNEXPLAINED * changed:
        misses, what = f"misfit {1e3 * left:.2g} mm", f"of a change of {1e3 * changed:.2g} mm"
        return replace(known, why_not=f"no rubber of this shape fits: {misses} {what}")
    covariance, found = fit.covariance, known
    if known.gauge is None:
        by_shapes, weighed = (_gauge(each, by_file.value) for each in (alone, fit))
        found = replace(known, gauge_from=known.told_by, both=(by_shapes, by_file))
        spread = np.hypot(by_shapes.sigma, by_file.sigma)
        apart = abs(by_shapes.value - by_file.value) / spread
        mean_sigma = by_shapes.sigma * by_file.sigma / spread
        together = (by_shapes.sigma + by_file.sigma) / spread  # over the root of summed squares
        sigma = max(weighed.sigma, float(mean_sigma * max(together, apart)))
        if found.contradicts_file:
            ends = (by_shapes.low, by_shapes.high, by_file.low, by_file.high)
            sigma = max(sigma, *(abs(end - weighed.value) / HALF_95 for end in ends))
        found = replace(found, gauge=Quantity.normal(weighed.value, sigma))
        covariance = covariance * (sigma / weighed.sigma) ** 2
    held = fit.covariance[0, 0] - fit.covariance[0, 1] ** 2 / fit.covariance[1, 1]
    q = Quantity.normal(float(fit.vector[0]), float(np.sqrt(max(held, 0.0))))
    if not 0.0 < q.low <= q.high < 1.0:
        what = "press is too shallow" if found.told_by == "press" else "levels differ too little"
        why = f"the {what}, or constant tension fits as well"
        return replace(found, why_not=why)
    wide = Quantity.normal(float(fit.vector[0]), float(np.sqrt(covariance[0, 0])))
    low, high = max(wide.low, SMALLEST_Q), min(wide.high, LARGEST_Q)
    return replace(found, prestretch=Quantity(*(x ** (-1.0 / 6.0) for x in (q.value, high, low))))


def _gauge(fit: Fit, start_pa: float) -> Quantity:
    """Gauge pressure of a fit that began at one, Pa."""
    return Quantity.normal(
        start_pa * float(fit.vector[1]), start_pa * float(np.sqrt(fit.covariance[1, 1]))
    )
