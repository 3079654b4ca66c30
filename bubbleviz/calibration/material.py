"""Pre-stretch and gauge pressure from inflation levels, a press and the open chamber."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.rest_frames import FrameSamples, collect
from bubbleviz.calibration.rubber_problem import (
    LARGEST_Q,
    SHARE_SIGMA,
    SMALLEST_Q,
    RubberProblem,
)
from bubbleviz.calibration.tension import Quantity
from bubbleviz.errors import InputError
from bubbleviz.progress import Progress, quiet
from bubbleviz.recordings import LAG, MIN_FRAMES, FrameSource, robust_sigma
from bubbleviz.result import HALF_95
from bubbleviz.sensor import Sensor

_MAX_UNEXPLAINED = 0.25  # largest share of the change of range that the rubber model may not fit


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
    if not shapes:
        return found
    found = replace(found, shapes_kind="levels" if levels else "press")
    try:
        return _fitted(found, shapes, level_sigma_pa)
    except InputError as error:
        return replace(found, why_not=str(error))


def _fitted(
    found: Identification,
    shapes: Sequence[FrameSamples],  # levels, or a press
    level_sigma_pa: float | None,
) -> Identification:
    """The same with λ and gauge pressure of the rubber, or the reason why λ is not determined.

    λ counts as determined unless its interval at the gauge pressure found holds 1. One that holds
    constant tension ends at the largest λ: rubber of the best λ is nearer to the truth than that.
    Raises InputError: no rubber explains the shapes.
    """
    names, kind, file = ", ".join(s.source_name for s in shapes), found.shapes_kind, found.gauge
    source = f"the press in {names}" if kind == "press" else f"inflation levels: {names}"
    problem = RubberProblem(found, shapes, level_sigma_pa, pressed=kind == "press")
    values, covariances, unexplained = problem.fit(file.sigma / file.value)
    change, rises = problem.change_rms_m, problem.rises_pa
    known = replace(found, rises_pa=rises, change_rms_m=change, unexplained_rms_m=unexplained)
    if unexplained > _MAX_UNEXPLAINED * change:
        misfit = f"misfit {1e3 * unexplained:.2g} mm rms of a change of {1e3 * change:.2g} mm rms"
        return replace(known, why_not=f"no rubber of this shape at rest fits: {misfit}")
    q, covariance = float(values[1, 0]), covariances[1]
    # variance of q at a fixed gauge pressure, and at the one found
    conditional = covariance[0, 0] - covariance[0, 1] ** 2 / covariance[1, 1]
    variance = covariance[0, 0]
    if found.vented is None:
        shapes_alone, both = (
            Quantity.normal(file.value * share, file.value * float(np.sqrt(square)), source)
            for share, square in zip(values[:, 1].tolist(), covariances[:, 1, 1], strict=True)
        )
        known = replace(known, gauge_candidates=(shapes_alone, file))
        sigma = _sigma_of_mean(known, both)
        gauge = Quantity.normal(both.value, sigma, f"{source}; {file.source}")
        known = replace(known, gauge=gauge)
        variance = variance * (sigma / both.sigma) ** 2
    else:
        source = f"{source}; the gauge pressure from {file.source}"
    if q < 1.01 * SMALLEST_Q:
        return replace(known, why_not=f"the {kind} fit a constant tension best")
    if Quantity.normal(q, float(np.sqrt(max(conditional, 0.0)))).high >= 1.0:
        return replace(known, why_not=f"λ = 1 fits the {kind} as well")
    wide = Quantity.normal(q, float(np.sqrt(variance)))
    low, high = max(wide.low, SMALLEST_Q), min(wide.high, LARGEST_Q)
    value, low, high = (x ** (-1.0 / 6.0) for x in (q, high, low))
    stretch, share = Quantity(value, low, high, source), None
    if found.surfaces.chosen != "sphere" and found.surfaces.flat_sheet is not None:
        # errors of the model may count more in it, but it lies between 0 and 1
        sigma = min(float(np.sqrt(covariance[2, 2])), SHARE_SIGMA)
        share = Quantity.normal(float(values[1, 2]), sigma, source)
    return replace(known, prestretch=stretch, sheet_share=share, why_not="")


def _sigma_of_mean(known: Identification, mean: Quantity) -> float:
    """Standard deviation of the mean of the gauge pressures from shapes and sensor file, Pa.

    Model errors are the same in every recording and may have the sign of the file's error. So in
    the weighted mean the two errors add linearly, not in squares. A difference of the two gauge
    pressures beyond their deviations widens the interval as the Particle Data Group does. Beyond
    their 95 % intervals one of them is wrong, and the interval covers both of theirs.
    """
    assert known.gauge_candidates is not None
    shapes, file = known.gauge_candidates
    spread = np.hypot(shapes.sigma, file.sigma)
    apart = abs(shapes.value - file.value) / spread
    mean_sigma = shapes.sigma * file.sigma / spread
    linear_sum = (shapes.sigma + file.sigma) / spread
    sigma = max(mean.sigma, float(mean_sigma * max(linear_sum, apart)))
    if known.contradicts_file:
        ends = (shapes.low, shapes.high, file.low, file.high)
        sigma = max(sigma, *(abs(end - mean.value) / HALF_95 for end in ends))
    return sigma
