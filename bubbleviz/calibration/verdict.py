"""Verdict on an identification: a grade with reasons and advice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from bubbleviz.calibration.identification import Identification
from bubbleviz.calibration.material import RubberEstimate
from bubbleviz.calibration.tension import Quantity
from bubbleviz.calibration.validation import Validation

Grade = Literal["good", "usable", "doubtful"]
PressureText = Callable[[float], str]  # number and unit of a pressure in Pa

_GOOD, _USABLE = 0.02, 0.05  # relative half-width of γ0: below a force sensor's; worth a warning
_WELL_SEEN = 0.8  # of the dome's area; chosen
_FEW_FRAMES = 30  # one second of most depth cameras


@dataclass(frozen=True)
class Verdict:
    """Grade and sentences."""

    grade: Grade
    summary: str  # one sentence
    advice: tuple[str, ...]  # what was found and what to do about it, most important first


def pascals(pressure_pa: float) -> str:
    """Number and unit, as the command line writes it."""
    return f"{pressure_pa:.0f} Pa"


def judge(found: Identification, pressure: PressureText = pascals) -> Verdict:
    """Judge an identification by its own numbers, with pressures written by `pressure`."""
    tension = found.tension.tension
    relative = tension.half_width / tension.value
    warnings = _warnings(found, pressure)
    grade: Grade = "good"
    if relative > _GOOD or warnings:
        grade = "usable"
    if relative > _USABLE or (found.rubber is not None and found.rubber.contradicts_file):
        grade = "doubtful"
    value, low, high = tension.texts(2)
    summary = (
        f"{grade}: γ0 = {value} N/m, 95 % interval {low} to {high}"
        f" ({_percent(relative)} either way), at"
        f" {pressure(found.tension.gauge_pressure_pa)} gauge pressure"
    )
    return Verdict(grade, summary, (_surface(found), *warnings, *_notes(found)))


def _surface(found: Identification) -> str:
    surfaces = found.surfaces
    miss = {name: 1e3 * rms for name, rms in surfaces.left_out_rms_m.items()}
    if surfaces.chosen == "sphere":
        return (
            f"The dome is spherical: nothing else predicts it better than the sphere, which"
            f" misses by {miss['sphere']:.2g} mm rms."
        )
    if surfaces.chosen == "ellipsoid":
        return (
            f"Dome not spherical: the sphere misses by {miss['sphere']:.2g} mm; use the"
            f" ellipsoid ({miss['ellipsoid']:.2g} mm)."
        )
    return (
        f"Dome not spherical: the sphere misses by {miss['sphere']:.2g} mm, the ellipsoid by"
        f" {miss['ellipsoid']:.2g} mm; use the free-form surface ({miss['free-form']:.2g} mm)."
    )


def _warnings(found: Identification, pressure: PressureText) -> list[str]:
    """Reasons to grade an identification below good."""
    tension, fits = found.tension, found.fits
    out = []
    if found.samples.gas_pressure_pa is None:
        out.append(
            "The recording has no gas pressure: γ0 rests on the sensor file's gauge pressure, and"
            f" is wrong by as many percent as it is ({pressure(100.0)}:"
            f" {100 * tension.per_pascal:.2f} N/m). Record the pressure, or measure it."
        )
    given, rubber = found.given.pneumatics.gauge_pressure_pa, found.rubber
    change = tension.gauge_pressure_pa / given - 1.0
    if rubber is not None and rubber.both is not None:
        shapes, file = (_interval(each, pressure) for each in rubber.both)
        if rubber.contradicts_file:
            out.append(
                f"The gauge pressure is {shapes} by the {rubber.told_by} and {file} by the sensor"
                " file: one of them is wrong. Record the open chamber for ten seconds (--vented)."
            )
    elif abs(change) > _USABLE:
        out.append(
            f"The gauge pressure is {_percent(abs(change))} {'above' if change > 0 else 'below'}"
            " the sensor file's: inflate alike, and make sure that nothing touches the sensor."
        )
    if found.seen < _WELL_SEEN:
        out.append(
            f"{_percent(1.0 - found.seen)} of the dome is not seen: there the surface is the"
            " fitted cap's continuation, and contact is only inferred."
        )
    height = tension.dimensions["height_m"].value
    if abs(fits.rim_height_m) > max(3.0 * fits.rim_height_sigma_m, _GOOD * height):
        out.append(
            f"The edge of the cloud lies {1e3 * fits.rim_height_m:+.1f} mm from the drawing's rim"
            " plane: either the rim is hidden, or the camera's position is off by as much."
        )
    value, least = tension.tension.value, tension.least_squares_n_per_m
    apart = abs(least - value)
    if apart > max(_GOOD * value, tension.tension.half_width):
        out.append(
            f"The balance of the whole dome gives {value:.1f} N/m, least squares of its parts"
            f" {least:.1f} N/m, {_percent(apart / value)} apart: the mean curvature is not the same"
            " everywhere, and no one tension holds this shape exactly."
        )
    if found.samples.statistics.frames < _FEW_FRAMES:
        out.append(f"Only {found.samples.statistics.frames} frames: record {_FEW_FRAMES} or more.")
    return out


def _notes(found: Identification) -> list[str]:
    tension = found.tension
    part = max(tension.parts, key=lambda name: tension.parts[name])
    cause = {
        "pixels": "noise and fixed pattern of the pixels: more frames, or a better rectification",
        "frames": "drift from frame to frame: let gas and camera settle",
        "gas_pressure": "noise of the gas pressure: record longer",
        "facets": "the flat facets of the mesh: more nodes",
        "gauge_pressure": "the gauge pressure: record the open chamber (--vented)",
        "statics": "the oval rim, over which shape and pressure leave the mean tension open",
        "surface": "a shape that is hidden, too fine for the fit, or no ellipsoid: uncover the rim",
    }[part]
    notes = [
        f"Most of the interval comes from {cause}.",
    ]
    if found.gauge is None:
        notes.append(
            "The interval does not hold an error of the gauge pressure: 1 % of it"
            f" is 1 % of γ0, {tension.per_pascal * tension.gauge_pressure_pa / 100:.2f} N/m."
        )
    return notes


def rubber_advice(rubber: RubberEstimate | None) -> list[str]:
    """Sentences for the verdict."""
    if rubber is None:
        return [
            "λ is not determined: record the untouched sensor at two other inflations, 15 % of its"
            " gauge pressure apart, with their gas pressures (--level), or press it and hold."
        ]
    advice = []
    if rubber.prestretch is None:
        advice.append(f"λ is not determined: {rubber.why_not}.")
    else:
        value, low, high = rubber.prestretch.texts(3)
        advice.append(f"λ = {value}, 95 % interval {low} to {high}.")
    if rubber.both is not None and (gauge := rubber.gauge) is not None:
        value, low, high = gauge.texts(0)
        advice.append(
            f"By the {rubber.told_by} and the sensor file the gauge pressure is {value} Pa, 95 %"
            f" interval {low} to {high}: record the open chamber for ten seconds to know it more"
            " precisely (--vented)."
        )
    if rubber.gauge is None:
        advice.append(
            "The gauge pressure rests on the sensor file's atmospheric pressure, and force is as"
            " many percent wrong as it is: record the open chamber (--vented)."
        )
    return advice


def _interval(gauge: Quantity, pressure: PressureText) -> str:
    return f"{pressure(gauge.value)} ({pressure(gauge.low)} to {pressure(gauge.high)})"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def validation_advice(validation: Validation | None) -> list[str]:
    """One sentence, or none."""
    if validation is None:
        return []
    share = validation.rms_m / max(validation.untouched_rms_m, 1e-12)
    text = (
        f"Of the known press, {1e3 * validation.untouched_rms_m:.2f} mm rms from the untouched"
        f" membrane, {1e3 * validation.rms_m:.2f} mm rms are not predicted"
    )
    if share > 0.5:
        return [f"{text}: check the pose, the object, the gauge pressure and γ0."]
    return [f"{text}."]
