"""λ and gauge pressure from a constant press, on simulated rubber."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.calibration import Quantity, advice, collect_press, summary, with_rubber
from bubbleviz.camera import DepthCamera
from bubbleviz.membrane import (
    EllipsoidalCap,
    Gas,
    Inflation,
    RubberForward,
    RubberMembrane,
    inverse_metric,
    mean_curvature,
    mesh_cap,
)
from bubbleviz.recordings import HeldFrames
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor, changed
from bubbleviz.simulation import ATMOSPHERE_PA, CAMERA_NOISE, still_frames
from tests.membrane.domes import pose

from .identified import identify, opened, with_air

RIM, HEIGHT, G = (0.045, 0.038), 0.022, 4000.0
STRETCH, MU_H = 1.2, 90.0
FREE, HELD = 20, 21
GIVEN_ATMOSPHERE = ATMOSPHERE_PA + 900.0
"""The sensor file's, which nobody measured."""


def press(membranes, gas_pa, camera, seed):
    """Frames without contact, then frames with a ball at a constant pose."""
    parts = zip(membranes, gas_pa, (FREE, HELD), strict=True)
    frames = [
        frame
        for k, (mesh, gas, count) in enumerate(parts)
        for frame in still_frames(camera, mesh, gas, CAMERA_NOISE, count, seed + k)
    ]
    in_order = [replace(each, index=k, time_s=k / 30.0) for k, each in enumerate(frames)]
    return HeldFrames(in_order, "press")


@pytest.fixture(scope="module")
def truth():
    return pressed_rubber(STRETCH, MU_H)


def pressed_rubber(stretch, mu_h, gauge_pa=G, flat=False, friction=0.0):
    """Sensor, meshes at rest and pressed, their gas pressures, and λ; on a mesh of its own."""
    dome = cap = mesh_cap(EllipsoidalCap.of(RIM, HEIGHT), 900)
    if flat:
        cap = replace(dome, nodes=dome.nodes * [1.0, 1.0, 0.0])
    free = RubberMembrane(cap, 0.0, stretch**2 * inverse_metric(cap), mu_h)
    inflated = Inflation(free, np.zeros_like(cap.nodes)).at(gauge_pa, dome.nodes if flat else None)
    rest = replace(cap, nodes=inflated)
    membrane = RubberMembrane(rest, gauge_pa, stretch**2 * inverse_metric(cap), mu_h)
    sensor = given(float(rest.nodes[:, 2].max()))
    true_air = sensor.pneumatics.model_copy(
        update={"atmospheric_pressure_pa": ATMOSPHERE_PA, "gauge_pressure_pa": gauge_pa}
    )
    ball = load_object("sphere")
    top = rest.nodes[:, 2].max() - ball.vertices[:, 2].min()
    there = pose(-0.012, 0.006, top - 0.006)
    forward = RubberForward(membrane, Gas.of(true_air, rest))
    contact = forward.press(ball, there)
    if friction:
        (contact,) = forward.follow(ball, [there], friction)
    assert contact.converged
    pressed = replace(rest, nodes=rest.nodes + contact.displacement_3d_m)
    gas = np.array([0.0, contact.gas_pressure_change_pa]) + ATMOSPHERE_PA + gauge_pa
    mean_stretch = (1.0 - membrane.mean_tension / mu_h) ** (-1.0 / 6.0)
    return sensor, (rest, pressed), gas, mean_stretch


def given(height):
    width, rows, focal = 160, 120, 88.0
    return Sensor(
        name="dome",
        membrane=Membrane(shape="ellipsoidal_cap", rim_semi_axes_m=RIM, height_m=round(height, 3)),
        pneumatics=Pneumatics(
            gauge_pressure_pa=3000.0,
            atmospheric_pressure_pa=GIVEN_ATMOSPHERE,
            chamber_volume_m3=5e-5,
        ),
        camera=Camera(
            width=width, height=rows, fx=focal, fy=focal, cx=79.5, cy=59.5,
            position_m=(0.0, 0.0, -1.4 * RIM[0]),
        ),
    )  # fmt: skip


def identified(truth, seed=0, air_pa=GIVEN_ATMOSPHERE):
    sensor, membranes, gas, _ = truth
    sensor = with_air(sensor, air_pa)
    source = press(membranes, gas, DepthCamera.of(sensor.camera), seed)
    found = identify(source, sensor, range(FREE), nodes=300)
    return found, collect_press(source, found.samples, found.given)


@pytest.fixture(scope="module")
def pressed(truth):
    return identified(truth)


@pytest.fixture(scope="module")
def with_press(pressed):
    found, held = pressed
    assert held.frames[0] == FREE + 5  # the camera's filter has forgotten the way in
    return with_rubber(found, [], press=held)


def test_the_flat_sheet_compared_has_the_height_of_the_surface(pressed):
    """Its excess of tension is between those of sheets under increasing pressure."""
    surfaces = pressed[0].surfaces
    flat = replace(surfaces.mesh, nodes=surfaces.mesh.nodes * [1.0, 1.0, 0.0])
    rubber = RubberMembrane(flat, 0.0, 1.005**2 * inverse_metric(flat), 1.0)
    inflation, x, inflated = Inflation(rubber, np.zeros_like(flat.nodes)), None, []
    for pressure in range(38, 47, 2):  # it bears less than 47 Pa
        x = inflation.at(pressure, x)
        sheet = replace(flat, nodes=x)
        stress = 0.5 * np.trace(rubber.stress(x), axis1=1, axis2=2) / pressure
        mean = stress @ sheet.facet_areas / sheet.facet_areas.sum()
        inflated.append((x[:, 2].max(), mean * mean_curvature(sheet) - 1.0))
    height = surfaces.mesh.nodes[:, 2].max()
    low, high = np.interp([0.98 * height, 1.02 * height], *np.transpose(inflated))
    assert inflated[0][0] < 0.98 * height and 1.02 * height < inflated[-1][0]
    assert low - 1e-4 < surfaces.flat_sheet[1] < high + 1e-4


def test_press_determines_gauge_pressure_and_prestretch(truth, with_press):
    """The sensor file's atmosphere is 0.9 kPa too much."""
    rubber, stretch = with_press, truth[3]
    assert rubber.prestretch.source == "the press in press"
    file = "the recorded gas pressure minus the atmospheric pressure in the sensor file"
    assert rubber.gauge.source == f"the press in press; {file}"
    assert rubber.gauge.low < G < rubber.gauge.high
    assert rubber.gauge.value == pytest.approx(G, rel=0.05)
    assert rubber.gauge.half_width < 0.155 * G
    assert rubber.prestretch.low < stretch < rubber.prestretch.high
    mu_h = with_press.tension_n_per_m / (1.0 - rubber.prestretch.value**-6)
    assert mu_h == pytest.approx(MU_H, rel=0.05)
    air = with_press.sensor.pneumatics.atmospheric_pressure_pa
    assert air + rubber.gauge.value == pytest.approx(ATMOSPHERE_PA + G, abs=5.0)


def test_report_names_the_pressed_object(with_press):
    numbers = summary(with_press, {})
    assert numbers["rubber"]["from"] == "press"
    assert numbers["gauge_pressure_measured"] is True
    assert numbers["rubber"]["levels"]["rises_pa"] == with_press.rises_pa


@pytest.mark.long
def test_open_chamber_fixes_the_gauge_pressure_and_the_press_the_prestretch(truth):
    chamber = "the open-chamber recording vented"
    vented = Quantity.normal(ATMOSPHERE_PA, 2.0, chamber)
    found, held = identified(truth, seed=7, air_pa=ATMOSPHERE_PA)
    known = with_rubber(opened(found, vented), [], press=held)
    assert known.gauge.source == chamber
    assert known.gauge.value == pytest.approx(G, rel=0.003)
    rubber = known
    assert rubber.prestretch.low < truth[3] < rubber.prestretch.high
    assert rubber.prestretch.source == f"the press in press; the gauge pressure from {chamber}"


@pytest.mark.long
def test_stiff_rubber_has_a_prestretch_although_its_interval_holds_1():
    """The camera tilts by 0.6 mm across the image before the press. Constant tension, which a
    sensor without prestretch has, is the other extreme."""
    stiff = pressed_rubber(1.01, 1200.0)
    found, held = identified(stiff, air_pa=ATMOSPHERE_PA)
    tilted = held.statistics.range_m + np.linspace(-3e-4, 3e-4, 160)
    held = replace(held, statistics=replace(held.statistics, range_m=tilted))
    vented = Quantity.normal(ATMOSPHERE_PA, 2.0, "open chamber")
    known = with_rubber(opened(found, vented), [], press=held)
    assert known.prestretch is not None, known.why_not
    assert known.prestretch.low == 1.0 < stiff[3]
    assert stiff[3] < known.prestretch.high < 1.2


def test_a_reflection_next_to_the_press_changes_little(pressed, with_press):
    """A region of pixels is 3 mm too far during the press: outliers have little weight."""
    found, held = pressed
    glare = np.zeros(held.statistics.range_m.shape)
    glare[70:80, 95:115] = 3e-3
    ranges = held.statistics.range_m + glare
    shiny = replace(held, statistics=replace(held.statistics, range_m=ranges))
    shone = with_rubber(found, [], press=shiny)
    for name in ("gauge", "prestretch"):
        crossed, clean = getattr(shone, name), getattr(with_press, name)
        assert crossed.value == pytest.approx(clean.value, abs=0.5 * clean.half_width)


def test_press_without_information(pressed):
    found, held = pressed
    silent = replace(held, gas_pressure_pa=None)
    kept = with_rubber(found, [], press=silent)
    assert kept.sensor == found.sensor and "gas pressure" in kept.why_not
    untouched = replace(found.samples, gas_pressure_pa=found.samples.gas_pressure_pa + 400.0)
    kept = with_rubber(found, [], press=untouched)
    assert kept.sensor == found.sensor and "no dent" in kept.why_not
    wrong = replace(held, gas_pressure_pa=held.gas_pressure_pa - 600.0)
    kept = with_rubber(found, [], press=wrong)
    assert kept.gauge_candidates is None and kept.prestretch is None
    assert "the gas pressure falls by " in kept.why_not
    assert any("Forces are by constant tension" in line for line in advice(kept))
    drawn = replace(kept, given=changed(kept.given, membrane={"prestretch": 1.3}))
    assert any("λ = 1.3 in the sensor file is kept" in line for line in advice(drawn))
    assert kept.sensor == found.sensor


@pytest.mark.long
@pytest.mark.parametrize("stretch", [1.2, 1.3])
def test_interval_of_an_oval_sheet_stretched_equally(stretch):
    """Its unequal tension is due to the inflation over an oval rim, of which a press tells little.

    With its expected value as known, both intervals of λ are too narrow.
    """
    truth = pressed_rubber(stretch, 160.0, 2500.0, flat=True)
    found, held = identified(truth)
    known = with_rubber(found, [], press=held)
    assert known.prestretch.low < truth[-1] < known.prestretch.high
    assert known.gauge.low < 2500.0 < known.gauge.high


def test_friction_of_the_press_is_no_lower_prestretch():
    """As the contact grows the membrane sticks to the ball: a fit without friction has λ 1.02."""
    truth = pressed_rubber(1.06, 330.0, friction=0.6)
    found, held = identified(truth)
    known = with_rubber(found, [], press=held)
    assert known.prestretch.value == pytest.approx(truth[-1], abs=0.015)
    assert known.prestretch.low < truth[-1] < known.prestretch.high
    assert known.prestretch.high < 1.2
    assert known.gauge.value == pytest.approx(G, rel=0.1)
