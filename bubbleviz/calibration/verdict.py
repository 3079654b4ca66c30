"""Verdict on an identification: a grade with reasons and advice."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from bubbleviz.calibration.identification import RUBBER_NAMES, Identification
from bubbleviz.calibration.surface import SURFACE_NAMES, Quantity
from bubbleviz.result import HALF_95
from bubbleviz.wording import decimals_of

Grade = Literal["good", "usable", "doubtful"]
PressureText = Callable[[float], str]  # number and unit of a pressure in Pa

_GOOD, _USABLE = 0.02, 0.05  # largest relative half-width of γ0 for each grade
# The same for a force: √2 times the model's own ±4 %, so that the sensor file adds no more than the
# model; and more than the ±26 % of constant tension alone, so that a sensor of unknown λ is usable
_GOOD_FORCE, _USABLE_FORCE = 0.057, 0.3
_MIN_VISIBLE = 0.8  # share of the dome's area; chosen
_MIN_FRAMES = 30  # one second of most depth cameras
_COLUMNS = "name", "value", "source", "improvement"
_LEVELS = (
    "record the untouched sensor at two other inflations, 15 % of its gauge pressure apart, with"
    " their gas pressures (--level)"
)
_FARTHER = "record levels farther apart, or more (--level)"
_STEEP = "hardly possible: levels determine it on steep domes only"
_OF_TENSION = {
    "frames": "let gas and camera settle before recording (largest error: drift between frames)",
    "facets": "use more nodes, --nodes (largest error: flat facets of the mesh)",
    "gauge_pressure": "{chamber} (largest error: gauge pressure)",
    "statics": "not possible (largest error: tension that differs over the membrane, which shape "
    "and pressure do not determine)",
    "surface": "uncover the whole dome, rim included, and record more frames (largest error: shape "
    "that is hidden, or below noise and fixed pattern of the pixels)",
}
"""What would narrow γ0's interval, by the largest source of its error."""


def pascals(pressure_pa: float) -> str:
    """Pressure as the command line prints it, to 0.1 % or less."""
    return f"{pressure_pa:.{max(decimals_of(0.01 * pressure_pa, 2), 0)}f} Pa"


def grade(found: Identification) -> Grade:
    """Grade of an identification by its numbers."""
    tension = found.tension
    relative = _relative(tension)
    force = _relative(found.reference_force)
    contradictory = (
        found.contradicts_file
        or found.levels_contradict
        or found.chamber_contradicts_file
        or _tilt_rad(found) > (force or _GOOD_FORCE)  # it turns every force
    )
    if relative > _USABLE or force > _USABLE_FORCE or contradictory:
        return "doubtful"
    return "usable" if relative > _GOOD or _warnings(found, pascals) else "good"


def headline(found: Identification, pressure: PressureText = pascals) -> str:
    """The grade and γ0 in one line; `pressure` formats pressures."""
    tension = found.tension
    value, low, high = tension.possible().texts(2)
    force = found.reference_force
    forces = "" if force is None else f"; force of a press ±{_percent(_relative(force))}"
    if forces and found.prestretch is None and found.given.membrane.prestretch is not None:
        forces += " if λ is right"
    return (
        f"{grade(found)}: γ0 = {value} N/m, 95 % interval {low} to {high} "
        f"(±{_percent(_relative(tension))}), at {pressure(found.gauge.value)} gauge pressure"
        f"{forces}"
    )


def advice(found: Identification, pressure: PressureText = pascals) -> list[str]:
    """Findings with remedies, most important first."""
    pressed = [] if found.validation is None else [found.validation.summary]
    return [_surface(found), *_warnings(found, pressure), *pressed]


def _surface(found: Identification) -> str:
    surfaces = found.surfaces
    misfits = (f"{name} {1e3 * surfaces.left_out_rms_m[name]:.2g} mm" for name in SURFACE_NAMES)
    return (
        f"Shape used: {surfaces.chosen} (rms misfit on parts left out of the fit: "
        f"{', '.join(misfits)})."
    )


def _warnings(found: Identification, pressure: PressureText) -> list[str]:
    """Reasons to grade an identification below good."""
    surfaces = found.surfaces
    out = []
    if found.levels_contradict:
        out.append(
            f"Levels and gas pressures contradict each other: {found.why_not}; γ0 and every force"
            " may be wrong. Check which pressure belongs to which recording, at rest, of levels"
            " (--level) and of the open chamber (--vented)."
        )
    if found.chamber_contradicts_file:
        assert found.vented is not None
        air_pa = found.given.pneumatics.atmospheric_pressure_pa
        out.append(
            f"The gas pressure of the open chamber, {pressure(found.vented.value)}, differs from "
            f"the atmospheric pressure in the sensor file, {pressure(air_pa)}, by more than "
            "weather does, so gauge pressure and every force may be wrong: check that the chamber "
            "was open in that recording (--vented). If its pressure sensor has an offset, enter "
            "what it shows in open air as atmospheric_pressure_pa."
        )
    if found.focal_contradicts_rim:
        used = found.samples.camera.intrinsics
        texts = (
            f"{name} {of.value:.1f} ({of.low:.1f} to {of.high:.1f}) instead of"
            f" {getattr(used, name):.1f}"
            for name, of in found.focal_by_rim_px.items()
        )
        out.append(
            "The rim in the image has its size in the initial sensor file at focal lengths of"
            f" {' and '.join(texts)} pixels. A wrong focal length makes every force wrong by twice"
            " its percentage: correct the camera info, the scale of depth, or the rim in the"
            " initial sensor file (to 0.5 mm), and identify from that file."
        )
    if tilt_rad := _tilt_rad(found):
        assert surfaces.rim_plane is not None
        pose = surfaces.rim_plane.T_B_C
        position = ", ".join(f"{each:.4f}" for each in pose[:3, 3])
        turn = ", ".join(f"{each:.4f}" for each in Rotation.from_matrix(pose[:3, :3]).as_quat())
        out.append(
            f"The edge of the cloud lies in a plane tilted by {np.degrees(tilt_rad):.1f}° against "
            "the rim plane of the sensor file. If that edge is the rim, the camera's pose in the "
            "file is wrong, and the direction of every force by as much: enter position_m = "
            f"[{position}] and quaternion_xyzw = [{turn}] in the initial sensor file (the turn "
            "about z is kept), and identify from that file."
        )
    gauge, candidates = found.gauge, found.gauge_candidates
    known_to = f"known to ±{_percent(gauge.half_width / gauge.value)}"
    given = found.given.pneumatics
    change = gauge.value / given.gauge_pressure_pa - 1.0
    unexpected = HALF_95 * given.gauge_deviation_pa / given.gauge_pressure_pa
    local = ", or enter the atmospheric pressure of the place in the sensor file"
    if given.atmosphere_is_local:
        local = ""
    if found.samples.gas_pressure_pa is None:
        out.append(
            "Not every contact-free frame has a gas pressure, so γ0 and every force rest on the "
            f"sensor file's gauge pressure, {known_to}: record the gas pressure, or measure the "
            "gauge pressure and enter it with its standard deviation, gauge_sigma_pa."
        )
    elif candidates is not None and found.contradicts_file:
        shapes, file = (_interval(each, pressure) for each in candidates)
        out.append(
            f"Gauge pressure: {shapes} from the {found.shapes_kind}, {file} from "
            f"{candidates[1].source}; one of them is wrong. Record the open chamber "
            "for ten seconds (--vented)."
        )
    elif gauge.half_width > _USABLE * gauge.value:
        out.append(
            f"The gauge pressure is {known_to}, and every force no better: record the open chamber"
            f" for ten seconds (--vented){local}."
        )
    if candidates is None and abs(change) > max(_USABLE, unexpected):
        weather = "; after a change of weather or altitude record the open chamber (--vented)"
        known = found.vented is not None
        out.append(
            f"The gauge pressure is {_percent(abs(change))} {'above' if change > 0 else 'below'}"
            " the sensor file's: make sure that nothing touches the sensor, and inflate it as"
            f" before unless the pressure is meant to differ{'' if known else weather}."
        )
    if surfaces.visible_share < _MIN_VISIBLE:
        out.append(
            f"The camera does not see {_percent(1.0 - surfaces.visible_share)} of the dome: there "
            "the surface is extrapolated from the fitted cap, and contact is only inferred."
            " Uncover the camera, or check its pose in the sensor file."
        )
    height = surfaces.dimensions["height_m"].value
    rim = surfaces.rim_height_m
    if abs(rim) > max(3.0 * surfaces.rim_height_sigma_m, _GOOD * height):
        out.append(
            f"The edge of the cloud lies at z = {1e3 * rim:+.1f} mm, the rim of the sensor file at "
            "0: uncover the rim, or correct the camera's pose in the sensor file."
        )
    if found.shapes_kind and found.prestretch is None and not found.levels_contradict:
        kept = found.given.membrane.prestretch
        effect = "Forces are by constant tension, and their intervals wide"
        if kept is not None:
            effect = f"λ = {kept:g} in the sensor file is kept, with unknown error"
        more = _FARTHER if found.shapes_kind == "levels" else _LEVELS
        out.append(f"λ is not determined: {found.why_not}. {effect}: {more}.")
    force = found.reference_force
    if force is None:
        out.append(
            "A simulated press shows no force, so that of real ones is unknown: check the camera's"
            " pose and noise in the sensor file."
        )
    elif _relative(force) > _GOOD_FORCE:
        out.append(
            f"The force of {force.source} is known to ±{_percent(_relative(force))} (95 %): narrow"
            " the intervals of λ, gauge pressure and unequal tension, or reduce the noise of depth."
        )
    frames = found.samples.statistics.frames
    if frames < _MIN_FRAMES:
        out.append(f"Only {frames} contact-free frames: choose or record {_MIN_FRAMES} or more.")
    return out


def parameters(found: Identification, pressure: PressureText = pascals) -> list[dict[str, str]]:
    """Which data determine γ0, gauge pressure, and the parameters of the rubber.

    Each row has a `name`, the `value` with its 95 % interval, its `source`, or why it is not
    determined, and what would narrow the interval as `improvement`.
    """
    vented = found.vented is not None
    gauge = found.gauge
    chamber = "record the open chamber for ten seconds (--vented)"
    if found.samples.gas_pressure_pa is None:
        chamber = "record the gas pressure, and the open chamber (--vented)"
    chamber_text = chamber
    if vented:
        chamber_text = (
            "use a pressure sensor that differs less between recordings, and tell by how much"
            " (--level-sigma)"
        )
    part = max(found.tension_parts, key=lambda name: found.tension_parts[name])
    of_tension = _OF_TENSION[part].format(chamber=chamber_text)
    cut = gauge.possible()
    pressures = tuple(map(pressure, (cut.value, cut.low, cut.high)))
    rows = [
        ("γ0", _range(found.tension.possible().texts(2), " N/m"), found.tension.source, of_tension),
        ("gauge pressure", _range(pressures), gauge.source, chamber_text),
    ]
    if found.prestretch is None:
        narrower = f"{_LEVELS}, or press it deeply and hold still"
        rows.append(("λ", "not determined", found.why_not, narrower))
    for name, each in found.rubber.items():
        digits, narrower = 2, _LEVELS if found.shapes_kind == "press" else _FARTHER
        if name.startswith("unequal"):
            narrower = _STEEP
        if name == "prestretch":
            digits, narrower = 3, _FARTHER if vented else chamber
        rows.append((RUBBER_NAMES[name], _range(each.texts(digits)), each.source, narrower))
    return [dict(zip(_COLUMNS, row, strict=True)) for row in rows]


def sentence(row: dict[str, str]) -> str:
    """A row of `parameters` as a sentence or two."""
    return "{name}: {value} ({source}). To improve it: {improvement}.".format(**row)


def _range(texts: tuple[str, ...], unit: str = "") -> str:
    value, low, high = texts
    return f"{value}{unit}, 95 % interval {low} to {high}"


def _interval(gauge: Quantity, pressure: PressureText) -> str:
    cut = gauge.possible()
    return f"{pressure(cut.value)} ({pressure(cut.low)} to {pressure(cut.high)})"


def _tilt_rad(found: Identification) -> float:
    """Tilt of the cloud's edge against the rim plane where it is significant, else 0."""
    plane = found.surfaces.rim_plane
    if plane is None or plane.tilt_rad < HALF_95 * plane.sigma_rad:
        return 0.0
    return plane.tilt_rad


def _relative(of: Quantity | None) -> float:
    """Half of the 95 % interval over the value; 0 if there is none."""
    return 0.0 if of is None else of.half_width / of.value


def _percent(share: float) -> str:
    return f"{float(f'{100 * share:.2g}'):g} %"  # not 3.9e+02
