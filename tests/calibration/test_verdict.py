"""The verdict on γ0 uses all methods that the report lists."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.api.identifying import Identified
from bubbleviz.calibration import (
    Quantity,
    RimPlane,
    advice,
    grade,
    headline,
    parameters,
    reference_force,
    sentence,
)
from bubbleviz.membrane import Prestress
from bubbleviz.sensor import changed, load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.simulation import DepthNoise, Validation

from .domes import sphere
from .identified import identify

NOISE = DepthNoise(relative=0.003)


def identified(dome):
    return identify(dome, dome.sensor, range(len(dome)), nodes=200)


@pytest.fixture(scope="module")
def ball():
    """Ideal apart from the small number of frames, 20."""
    found = identified(sphere(0, NOISE, frames=20, scale=0.35))
    gas = np.full(20, 1e5 + found.gauge.value)
    samples = replace(found.samples, gas_pressure_pa=gas)
    force = Quantity.normal(2.0, 0.04, "a press of 4 mm")
    found = replace(found, samples=samples, reference_force=force)
    return gauged(with_seen_share(found, 1.0), 1.0)


def with_tension(found, relative, **changes):
    """The same with another relative half-width of γ0, and other fields of its surfaces."""
    value = found.surfaces.tension_m.value
    interval = Quantity(value, (1.0 - relative) * value, (1.0 + relative) * value)
    return replace(found, surfaces=replace(found.surfaces, tension_m=interval, **changes))


def in_frames(found, frames):
    statistics = replace(found.samples.statistics, frames=frames)
    return replace(found, samples=replace(found.samples, statistics=statistics))


def gauged(found, share, sigma_pa=1.0):
    """With so much of the sensor file's gauge pressure, which the file knows to `sigma_pa`."""
    given = changed(found.given, pneumatics={"gauge_sigma_pa": sigma_pa})
    gauge = Quantity.normal(share * given.pneumatics.gauge_pressure_pa, 0.0)
    return replace(with_tension(found, 0.01), given=given, gauge=gauge)


def without_gas(found):
    return replace(found, samples=replace(found.samples, gas_pressure_pa=None))


def rim_at(found, height_m, sigma_m):
    rim = {"rim_height_m": height_m, "rim_height_sigma_m": sigma_m}
    return replace(found, surfaces=replace(found.surfaces, **rim))


def tilted(found, degrees):
    """With the edge of the cloud tilted against the rim, known to half a degree."""
    plane = RimPlane(np.radians(degrees), np.radians(0.5), np.eye(4))
    return replace(found, surfaces=replace(found.surfaces, rim_plane=plane))


def with_seen_share(found, share):
    return replace(found, surfaces=replace(found.surfaces, visible_share=share))


@pytest.mark.parametrize(
    ("relative", "frames", "expected"),
    [
        (0.019, 30, "good"),
        (0.021, 30, "usable"),
        (0.049, 30, "usable"),
        (0.051, 30, "doubtful"),
        (0.019, 29, "usable"),
    ],
)
def test_grade_follows_the_interval_unless_there_is_a_warning(ball, relative, frames, expected):
    found = with_tension(in_frames(ball, frames), relative)
    assert grade(found) == expected
    line = headline(found)
    assert line.startswith(f"{expected}: γ0 = {ball.tension.value:.1f} N/m")
    assert f"(±{100 * relative:.2g} %)" in line
    few = any(f"Only {frames} contact-free frames" in line for line in advice(found))
    assert few is (frames < 30)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda found: gauged(found, 1.04), ""),
        (lambda found: gauged(found, 0.96), ""),
        (lambda found: gauged(found, 1.06), "The gauge pressure is 6 % above"),
        (lambda found: gauged(found, 0.94), "The gauge pressure is 6 % below"),
        (lambda found: gauged(found, 0.94, None), ""),  # within ±2 kPa
        (without_gas, "Not every contact-free frame has a gas pressure"),
        (lambda found: with_seen_share(found, 0.81), ""),
        (lambda found: with_seen_share(found, 0.79), "does not see 21 % of the dome"),
        (lambda found: rim_at(found, 5e-4, 1e-5), ""),  # of 45 mm: 2 % are 0.9 mm
        (lambda found: rim_at(found, -2e-3, 1e-3), ""),
        (lambda found: rim_at(found, -2e-3, 5e-4), "The edge of the cloud lies at z = -2.0 mm"),
        (lambda found: tilted(found, 0.9), ""),
        (lambda found: tilted(found, 1.5), "in a plane tilted by 1.5°"),
    ],
)
def test_warning_appears_beyond_its_limit(ball, change, said):
    found = in_frames(change(ball), 30)
    assert grade(found) == ("usable" if said else "good")
    if said:
        assert said in advice(found)[1]


@pytest.mark.parametrize(
    ("excess_pa", "place_pa", "expected"),
    [
        (1900.0, 101_325.0, "good"),
        (2100.0, 101_325.0, "doubtful"),
        (-9000.0, 101_325.0, "good"),  # high up
        (-2100.0, 95_000.0, "doubtful"),
    ],
)
def test_an_open_chamber_whose_pressure_is_no_weather_is_doubtful(
    ball, excess_pa, place_pa, expected
):
    given = changed(ball.given, pneumatics={"atmospheric_pressure_pa": place_pa})
    vented = Quantity.normal(place_pa + excess_pa, 5.0, "open")
    found = replace(in_frames(ball, 30), given=given, vented=vented)
    assert grade(found) == expected
    assert any("open chamber" in line for line in advice(found)) is (expected == "doubtful")


def test_a_tilt_that_turns_forces_beyond_their_interval_is_doubtful(ball):
    assert grade(tilted(in_frames(ball, 30), 6.0)) == "doubtful"


@pytest.mark.parametrize(
    ("relative", "expected"),
    [(0.055, "good"), (0.06, "usable"), (0.29, "usable"), (0.31, "doubtful")],
)
def test_grade_follows_the_interval_of_a_force_too(ball, relative, expected):
    force = Quantity(2.0, 2.0 - 2.0 * relative, 2.0 + 2.0 * relative, "a press of 4 mm")
    found = replace(in_frames(ball, 30), reference_force=force)
    assert grade(found) == expected
    assert headline(found).endswith(f"; force of a press ±{100 * relative:.2g} %")
    assert any("press of 4 mm" in line for line in advice(found)) is (expected != "good")


def test_a_sensor_whose_simulated_press_shows_no_force_is_not_good(ball):
    found = replace(in_frames(ball, 30), reference_force=None)
    assert grade(found) == "usable"
    assert "A simulated press shows no force" in advice(found)[1]


def test_interval_of_the_tension_ends_at_zero_also_in_python(ball):
    unsure = replace(ball, gauge=Quantity.normal(ball.gauge.value, ball.gauge.value))
    shown = Identified(unsure, unsure.samples, "dome.toml")
    assert shown.tension_interval_n_per_m[0] == 0.0 and "95 % within 0.00…" in repr(shown)


@pytest.mark.parametrize(("noise", "low", "high"), [(0.003, 0.04, 0.05), (0.2, 0.15, 0.35)])
def test_force_of_a_simulated_press_includes_the_noise_of_depth(noise, low, high):
    preset = load_sensor("pico_flexx_75mm")
    rubber = {"nodes": 400, "prestretch": 1.2}
    model = SensorModel.of(changed(preset, camera={"noise_relative": noise}, membrane=rubber))
    force = reference_force(model)
    assert low < force.half_width / force.value < high


def test_parameters_list_their_origin_and_how_to_improve_them(ball):
    tension, gauge, stretch = parameters(ball)
    assert "95 % interval" in gauge["value"] and "(--vented)" in gauge["improvement"]
    assert stretch["value"] == "not determined" and "(--level)" in stretch["improvement"]
    assert "neither levels nor" in sentence(stretch)
    parts = ball.surfaces.tension_parts_m
    for name, said in {"frames": "drift", "facets": "more nodes", "surface": "uncover"}.items():
        found = with_tension(ball, 0.01, tension_parts_m=parts | {name: 10.0 * max(parts.values())})
        tension = parameters(found)[0]
        assert said in tension["improvement"] and f"{ball.tension_n_per_m:.0f}" in tension["value"]


def test_unequal_tension_of_an_oval_is_in_the_interval_of_its_mean(ball):
    """0.1 of it, on a rim where 1 changes the mean tension by 30 %."""
    even = Prestress.of(ball.mesh, 1.0)
    field = even.times(0.3 * ball.surfaces.tension_m.value / even.mean_tension(ball.mesh))
    uneven = replace(ball.surfaces, unequal={"unequal_tension_x": field})
    along = Quantity.normal(0.0, 0.1, "levels")
    oval = replace(ball, surfaces=uneven, rubber={"unequal_tension_x": along})
    expected = np.hypot(ball.tension.half_width, 1.96 * 0.03 * ball.tension_n_per_m)
    assert oval.tension.half_width == pytest.approx(expected, rel=1e-3)
    assert grade(oval) == "doubtful"
    assert "which shape and pressure do not determine" in parameters(oval)[0]["improvement"]


def test_the_interval_of_a_low_gauge_pressure_shows_its_ends(ball):
    low = replace(ball, gauge=Quantity.normal(105.0, 0.2))
    assert parameters(low)[1]["value"] == "105.0 Pa, 95 % interval 104.6 Pa to 105.4 Pa"
    usual = replace(ball, gauge=Quantity.normal(5257.4, 2.0))
    assert parameters(usual)[1]["value"] == "5257 Pa, 95 % interval 5253 Pa to 5261 Pa"


def test_what_is_known_along_x_has_a_row_with_its_sign(ball):
    for name, value, sigma, shown in (
        ("stiffness gradient x", -0.12, 0.05, "-0.12, 95 % interval -0.22 to -0.02"),
        ("unequal tension x", 0.08, 0.1, "0.08, 95 % interval -0.12 to 0.28"),
    ):
        rubber = {name.replace(" ", "_"): Quantity.normal(value, sigma, "levels")}
        row = parameters(replace(ball, rubber=rubber, shapes_kind="levels"))[-1]
        assert (row["name"], row["value"], row["source"]) == (name, shown, "levels")
    assert "steep domes only" in row["improvement"]


@pytest.mark.parametrize(
    ("left", "overlap", "why"),
    [
        (1.9e-3, 0.8, ()),
        (2.1e-3, 0.8, ("membrane",)),
        (1.9e-3, 0.24, ("overlap by 24 %",)),
        (2.1e-3, 0.24, ("membrane", "overlap by 24 %")),
        (1.9e-3, np.nan, ("has a contact patch",)),
    ],
)
def test_poorly_predicted_known_press_needs_a_check(left, overlap, why):
    points, distance, force = np.zeros((4, 3)), np.full((5, 5), left), np.zeros(3)
    pixels = np.arange(25).reshape(5, 5)  # NaN: none has a patch
    patches = (pixels < share for share in (25 * np.isfinite(overlap), 25 * overlap))
    press = Validation(points, distance, 4e-3, *patches, force, force)
    line = press.summary
    assert len(press.failures) == len(why)
    assert all(word in text for word, text in zip(why, press.failures, strict=True))
    assert ("poor" in line) is ("Check the pose" in line) is bool(why)
    if not why or "membrane" in why:
        assert f"membrane {1e3 * left:.2f} mm rms from" in line and "untouched one 4.00 mm" in line
