"""λ and gauge pressure from inflation levels, on simulated rubber."""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.signal import lfilter
from small_press import record

from bubbleviz.calibration import (
    Quantity,
    advice,
    collect,
    grade,
    open_chamber,
    rest_gauge,
    with_rubber,
)
from bubbleviz.errors import InputError
from bubbleviz.membrane import Inflation, RubberMembrane, inverse_metric, prestressed
from bubbleviz.recordings import Frame, HeldFrames
from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.simulation import ATMOSPHERE_PA, DepthNoise, InflatedRubber
from tests.oracles.axial_mesh import swept_mesh
from tests.oracles.round_sheet import round_sheet
from tests.oracles.rubber_oracle import AxialRubber
from tests.program import output_of
from tests.small_press import changed

from .identified import identify, opened, with_air

G = 2500.0
WIDTH, FRAMES, NODES = 80, 10, 350


@cache
def sheet():
    return round_sheet(0.045, 110.0, 1.15, G)


@cache
def source_of(level, gas_error_pa=0.0):
    """Frames of the sheet at a level, each level with noise of its own."""
    seed = round(1e3 * level)
    return sheet().recording(level, seed, frames=FRAMES, width=WIDTH, gas_error_pa=gas_error_pa)


@pytest.mark.parametrize("level", [pytest.param(0.85, marks=pytest.mark.long), 1.15])
def test_inflation_equals_the_meridian_solution(level):
    truth = AxialRubber(0.045, 110.0, 1.15, G)
    rest = swept_mesh(truth.rest, 1000)
    inflated = Inflation(prestressed(rest, G, 110.0)).at(level * G)
    exact = swept_mesh(replace(truth, gauge_pressure_pa=level * G).rest, 1000).nodes
    motion = np.linalg.norm(exact - rest.nodes, axis=1)
    error = np.linalg.norm(inflated - exact, axis=1)
    assert error.max() < 0.03 * motion.max()
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(motion**2))


@pytest.mark.parametrize(
    "share", [-0.6, *(pytest.param(each, marks=pytest.mark.long) for each in (0.1, 0.5))]
)
def test_an_inflated_membrane_is_in_equilibrium(share):
    """Nodal forces of rubber and gas cancel, apart from the residual at rest."""
    rest = swept_mesh(AxialRubber(0.045, 110.0, 1.15, G).rest, 300)
    membrane = prestressed(rest, G, 110.0)
    x = Inflation(membrane).at((1.0 + share) * G)
    load = (1.0 + share) * G * membrane.volume_gradient(x)
    left = (membrane.force(x) - load - membrane.rest_force)[membrane.moving]
    assert np.abs(left).max() < 1e-6 * np.abs(load).max()


@pytest.mark.long
def test_command_finds_rubber_and_gauge_pressure(tmp_path):
    """Levels of ±15 %; the sensor file's atmosphere is 0.7 kPa too much."""
    names = {0.85: "low", 1.0: "rest", 1.15: "high"}
    files = {
        level: record(tmp_path / f"{name}.mcap", source_of(level)) for level, name in names.items()
    }
    given = sheet().sensor(WIDTH)
    given = changed(given, pneumatics={"atmospheric_pressure_pa": ATMOSPHERE_PA + 700.0})
    (tmp_path / "given.toml").write_text(sensor_to_toml(given))
    out = tmp_path / "new.toml"
    words = (files[1.0], "--sensor", tmp_path / "given.toml", "--nodes", 200, "--out", out)
    levels = ("--level", files[0.85], "--level", files[1.15])
    told = output_of("identify", *words, *levels, "--report", tmp_path / "report", "--json")
    found = json.loads(told)["rubber"]
    sensor = load_sensor(out)
    saved = sensor.calibration
    for interval, truth in (
        (saved.gauge_interval_pa, G),
        (saved.prestretch_interval, sheet().prestretch),
        (saved.tension_interval_n_per_m, sheet().tension_n_per_m),
    ):
        assert interval[0] < truth < interval[1]
    assert sensor.pneumatics.gauge_pressure_pa == pytest.approx(G, rel=0.05)
    assert sensor.membrane.prestretch == pytest.approx(sheet().prestretch, abs=0.04)
    assert sensor.pneumatics.atmospheric_pressure_pa == pytest.approx(ATMOSPHERE_PA, abs=150.0)
    assert saved.prestretch_from == "inflation levels: low.mcap, high.mcap"
    assert found["levels"]["unexplained_rms_m"] < 0.1 * found["levels"]["change_rms_m"]
    report = (tmp_path / "report" / "report.html").read_text()
    assert "inflation levels: low.mcap, high.mcap; the recorded gas pressure minus" in report


def chamber(pressures):
    """Frames of the open chamber, as far as they matter."""
    dark = np.full((2, 2), np.nan, np.float32)
    frames = [Frame(k, k / 30.0, dark, None, each) for k, each in enumerate(pressures)]
    return HeldFrames(frames, "vented")


OFFSET = 400.0
"""What the absolute sensor shows too much, inflated and vented alike."""


@pytest.fixture(scope="module")
def vented():
    shown = ATMOSPHERE_PA + OFFSET + np.random.default_rng(0).normal(0.0, 5.0, 60)
    return open_chamber(chamber(list(shown)))


@pytest.fixture(scope="module")
def found(vented):
    return identify(
        source_of(1.0, OFFSET),
        with_air(sheet().sensor(WIDTH), vented.value),
        range(FRAMES),
        nodes=NODES,
    )


def level(found, share):
    return collect(source_of(share, OFFSET), found.given, range(FRAMES))


@pytest.fixture(scope="module")
def levels(found):
    return [level(found, share) for share in (0.85, 1.15)]


@pytest.fixture(scope="module")
def free(found, levels):
    """By levels alone."""
    return with_rubber(found, levels)


@pytest.fixture(scope="module")
def known(found, vented, levels):
    """By levels and the gauge pressure of the open chamber."""
    return with_rubber(opened(found, vented), levels)


@pytest.mark.long
def test_stretch_that_levels_hardly_tell_from_constant_tension():
    """λ of 1.55: the interval holds it, and ends at constant tension."""
    rubber, noise = round_sheet(0.045, 123.0, 1.4, 4000.0), DepthNoise(absolute_m=1e-4)
    rest, *others = (
        rubber.recording(share, k, noise, FRAMES, WIDTH)
        for k, share in enumerate((1.0, 0.85, 1.15))
    )
    found = identify(rest, with_air(rubber.sensor(WIDTH), ATMOSPHERE_PA + 300.0), nodes=500)
    found = with_rubber(found, [collect(each, found.given, range(FRAMES)) for each in others])
    assert found.prestretch.low < rubber.prestretch < found.prestretch.high
    assert found.prestretch.high > 3.0
    assert found.prestretch.value == pytest.approx(rubber.prestretch, rel=0.1)
    assert found.sensor.membrane.prestretch == pytest.approx(found.prestretch.value, abs=1e-4)


def test_open_chamber_gives_the_gauge_pressure(found, vented):
    """The zero of the absolute sensor cancels; its errors between recordings do not."""
    only = with_rubber(opened(found, vented), [])
    assert only.gauge.source == "the open-chamber recording vented"
    assert only.prestretch is None
    assert only.gauge.value == pytest.approx(G, rel=0.002)
    assert only.gauge.half_width == pytest.approx(1.96 * 0.01 * G, rel=0.02)
    precise = rest_gauge(found.samples, found.given, vented, level_sigma_pa=1.0)
    assert precise.low < G < precise.high
    assert precise.half_width < 0.005 * G
    assert only.sensor.pneumatics.atmospheric_pressure_pa == pytest.approx(
        ATMOSPHERE_PA + OFFSET, abs=3.0
    )
    assert "neither levels nor" in only.why_not


def test_known_gauge_pressure_makes_the_prestretch_more_certain(known, free):
    assert known.prestretch.low < sheet().prestretch < known.prestretch.high
    assert known.prestretch.value == pytest.approx(sheet().prestretch, abs=0.02)
    width = known.prestretch.half_width
    assert free.prestretch is None or free.prestretch.half_width > 2.0 * width


@pytest.mark.long
def test_interval_of_the_prestretch_follows_that_of_the_gauge_pressure(found, free, levels):
    """Were the true gauge pressure at one end of its interval, λ would be within its own."""
    for end in (free.gauge.low, free.gauge.high):
        told = replace(found, gauge=Quantity.normal(end, 1.0), vented=free.gauge)
        stretch = with_rubber(told, levels).prestretch.value
        assert free.prestretch.low < stretch < free.prestretch.high


def test_tension_that_shape_leaves_open_does_not_widen_the_prestretch(found, vented, known, levels):
    """The fit has the unequal tension as an unknown: once is enough."""
    shape, parts = found.surfaces.tension_m, found.surfaces.tension_parts_m
    open_part = 0.05 * shape.value
    uneven = replace(
        found.surfaces,
        tension_m=Quantity.normal(shape.value, float(np.hypot(shape.sigma, open_part))),
        tension_parts_m=parts | {"statics": open_part},
    )
    same = with_rubber(replace(opened(found, vented), surfaces=uneven), levels).prestretch
    assert same.half_width == pytest.approx(known.prestretch.half_width, rel=1e-3)


@pytest.mark.parametrize("off", [-0.02, pytest.param(0.02, marks=pytest.mark.long)])
def test_a_level_whose_pressure_is_off_by_two_percent_widens_the_interval(
    found, vented, levels, off
):
    """±2 % is the total error band of common sensors; a better one gives a narrower interval."""
    low, high = levels
    high = replace(high, gas_pressure_pa=high.gas_pressure_pa + off * 1.15 * G)
    for given in (found, opened(found, vented)):
        usual = with_rubber(given, [low, high])
        assert usual.gauge.low < G < usual.gauge.high
        stretch = usual.prestretch
        assert stretch is None or stretch.low < sheet().prestretch < stretch.high
    exact = with_rubber(opened(found, vented), [low, high], level_sigma_pa=1.0).prestretch
    assert not exact.low < sheet().prestretch < exact.high


@cache
def oval_sheet():
    """Shape and pressure leave part of its stress open, which is far from uniform."""
    return InflatedRubber.oval_sheet((0.0557, 0.0396), 140.0, 1.05, G)


def recorded(rubber, share, width=224, **more):
    seed = round(1e3 * share)
    return rubber.recording(share, seed, width=width, gas_error_pa=OFFSET, **more)


@pytest.mark.long
def test_interval_on_an_oval_rim_holds_any_stress_that_balances(vented):
    oval = oval_sheet()
    given = with_air(oval.sensor(224), vented.value)
    rest = opened(identify(recorded(oval, 1.0, frames=60), given, range(60)), vented)
    low, high = (
        collect(recorded(oval, share, frames=60), given, range(60)) for share in (0.85, 1.15)
    )
    high = replace(high, gas_pressure_pa=high.gas_pressure_pa + 0.02 * 1.15 * G)
    stretch = with_rubber(rest, [low, high]).prestretch
    assert stretch.low < oval.prestretch < stretch.high


@pytest.mark.long
@pytest.mark.parametrize("moulded", [False, True])
def test_gauge_pressure_by_levels_on_an_oval_rim(vented, moulded):
    """The stress of a film, which shape and pressure would allow as well, gives 8 % less.

    A sheet may be stiffer in the middle than near its rim, and levels tell G only as well as they
    tell that.
    """
    moulded_dome = partial(InflatedRubber.moulded_dome, (0.0557, 0.0396), 0.020, 150.0, 1.1, G)
    rubber = moulded_dome() if moulded else oval_sheet()
    given, quiet = with_air(rubber.sensor(224), vented.value), DepthNoise(absolute_m=2e-5)
    rest, low, high = (
        recorded(rubber, share, frames=20, noise=quiet) for share in (1.0, 0.85, 1.15)
    )
    found = identify(rest, given, range(20))
    levels = [collect(each, given, range(20)) for each in (low, high)]
    fitted = with_rubber(found, levels)
    alone, _ = fitted.gauge_candidates
    along = fitted.rubber["unequal_tension_x"]
    assert fitted.sensor.membrane.unequal_tension_x == pytest.approx(along.value, abs=1e-3)
    assert along.low < (-0.022 if moulded else -0.099) < along.high  # by its stress
    if moulded:
        assert alone.value == pytest.approx(G, rel=0.04)
    else:
        assert along.half_width < 0.1  # 0.21 without levels
    assert alone.low < G < alone.high
    assert alone.half_width < 0.3 * G


@cache
def even_dome():
    return InflatedRubber.moulded_dome((0.045, 0.045), 0.028, 160.0, 1.05, 2.0 * G)


def uneven_dome(along_x, to_rim):
    """Moulded rubber; its stiffness changes to the rim along x, and all around from its mean."""
    even = even_dome()
    mesh = even.sheet
    x, y = (mesh.nodes[mesh.triangles, k].mean(axis=1) / 0.045 for k in (0, 1))
    stress_free = even.sheet_stretch**2 * inverse_metric(mesh)
    return inflated(
        even, stress_free, 160.0 * (1.0 + along_x * x + to_rim * (2.0 * (x**2 + y**2) - 1.0))
    )


def inflated(even, stress_free, mu_h):
    """The same with other rubber."""
    mesh = even.sheet
    inflation = Inflation(RubberMembrane(mesh, 0.0, stress_free, mu_h), np.zeros_like(mesh.nodes))
    return replace(even, shape=lambda pressure: replace(mesh, nodes=inflation.at(pressure)))


def by_levels(rubber, vented, noise_m=5e-5, width=112):
    rest, *levels = (
        recorded(rubber, share, width, frames=FRAMES, noise=DepthNoise(absolute_m=noise_m))
        for share in (1.0, 0.85, 1.15)
    )
    given = with_air(rubber.sensor(width), vented.value)
    found = opened(identify(rest, given, range(FRAMES), nodes=200), vented)
    return with_rubber(found, [collect(each, given, range(FRAMES)) for each in levels])


@pytest.mark.parametrize(
    "gradient", [(0.2, 0.15), pytest.param((0.0, 0.0), marks=pytest.mark.long)]
)
def test_levels_tell_a_stiffness_that_changes_over_the_membrane(vented, gradient):
    """The levels alone do not contradict the true gauge pressure then."""
    fitted = by_levels(uneven_dome(*gradient), vented)
    for axis, true in zip("xyr", (gradient[0], 0.0, gradient[1]), strict=True):
        name = f"stiffness_gradient_{axis}"
        found = fitted.rubber[name]
        assert found.low < true < found.high
        assert found.half_width < 0.1  # before: 0.2
        in_file = getattr(load_sensor(fitted.sensor).membrane, name)
        assert in_file == pytest.approx(found.value, abs=1e-4)


@pytest.mark.long
def test_interval_holds_an_unequal_stretch_that_levels_do_not_tell(vented):
    """22 % along y, 10 % along x; a dome that needs more than its λ for its area has none.

    Truth by the tensions of flat rubber before inflation, T₁ = μh (λ₁/λ₂ − (λ₁λ₂)⁻³).
    """
    even, x, y = InflatedRubber.oval_sheet((0.045, 0.045), 200.0, 1.16, G), 1.1, 1.22
    free = replace(even.sheet, nodes=even.sheet.nodes / [x, y, 1.0])
    sheet = by_levels(inflated(even, inverse_metric(free), 200.0), vented).rubber
    true = (x / y - y / x) / (x / y + y / x - 2.0 * (x * y) ** -3)
    assert sheet["unequal_tension_x"].low < true < sheet["unequal_tension_x"].high
    assert sheet["unequal_tension_xy"].low < 0.0 < sheet["unequal_tension_xy"].high
    assert by_levels(even_dome(), vented, 1e-3).rubber["unequal_tension_x"].half_width < 0.02


@pytest.mark.parametrize(("readings", "correlation", "least"), [(10, 0.0, 0.94), (30, 0.5, 0.9)])
def test_interval_of_the_open_chamber_holds_its_pressure(readings, correlation, least):
    """In few readings, too, and where a filter of the sensor makes neighbours alike."""
    white = np.random.default_rng(1).normal(0.0, 5.0, (1000, readings + 50))
    shown = lfilter([1.0], [1.0, -correlation], white)[:, 50:]
    found = [open_chamber(chamber(list(ATMOSPHERE_PA + each))) for each in shown]
    assert least < np.mean([each.low < ATMOSPHERE_PA < each.high for each in found]) < 0.98


def test_levels_that_do_not_determine_the_prestretch(found, levels):
    low, _ = levels
    kept = with_rubber(found, [replace(low, gas_pressure_pa=None)])
    assert kept.prestretch is None and "lack the gas pressure" in kept.why_not
    assert kept.sensor == found.sensor
    alike = with_rubber(found, [level(found, 1.002)])
    assert alike.prestretch is None and "from that at rest" in alike.why_not
    wrong = replace(low, gas_pressure_pa=low.gas_pressure_pa + 0.25 * G)  # it sank as it rose
    kept = with_rubber(found, [wrong])
    assert kept.prestretch is None and "250 Pa or less" in kept.why_not
    assert kept.gauge == found.gauge


@pytest.mark.parametrize("mistake", ["swapped", "a level as the open chamber"])
def test_levels_that_contradict_their_gas_pressures_are_doubtful(found, vented, levels, mistake):
    """Reported first, however narrow the interval of the gauge pressure is."""
    air, pressures = vented, [each.gas_pressure_pa for each in levels]
    if mistake == "swapped":
        pressures.reverse()
    else:
        air = Quantity.normal(float(np.mean(pressures[0])), 1.0, "the low level")
    shown = [replace(each, gas_pressure_pa=pressures[k]) for k, each in enumerate(levels)]
    force = Quantity.normal(2.0, 0.04, "a press of 4 mm")
    kept = replace(with_rubber(opened(found, air), shown), reference_force=force)
    assert kept.prestretch is None and kept.gauge.half_width < 0.05 * kept.gauge.value
    assert grade(kept) == "doubtful"
    assert kept.why_not.startswith("no rubber") and kept.why_not in advice(kept)[1]
    plain = replace(with_rubber(opened(found, vented), levels), reference_force=force)
    assert grade(plain) != "doubtful" and "contradict" not in " ".join(advice(plain))


def test_open_chamber_of_a_sensor_without_noise(found):
    """A coarse pressure sensor shows one value in all frames; the sensor file stays valid."""
    still = replace(found.samples, gas_pressure_pa=np.full(FRAMES, ATMOSPHERE_PA + G))
    still, silent = replace(found, samples=still), open_chamber(chamber([ATMOSPHERE_PA] * 10))
    gauge = rest_gauge(still.samples, still.given, silent, level_sigma_pa=0.0)
    known = replace(still, gauge=gauge, vented=silent)
    assert known.sensor.pneumatics.gauge_sigma_pa == 0.1
    assert known.sensor.pneumatics.gauge_pressure_pa == G


def test_open_chamber_needs_gas_pressures(found, vented):
    with pytest.raises(InputError, match="leave out the open chamber"):
        opened(replace(found, samples=replace(found.samples, gas_pressure_pa=None)), vented)
    with pytest.raises(InputError, match="chamber open"):
        open_chamber(chamber([None] * 30))


@pytest.mark.parametrize("shown", [-0.3, 1013.25])
def test_gas_pressure_of_the_open_chamber_is_absolute_and_in_pascals(shown):
    """A gauge pressure sensor shows 0, another absolute one hectopascals."""
    with pytest.raises(InputError, match=f"^vented: gas pressure {shown:z.0f} Pa .* absolute"):
        open_chamber(chamber([shown] * 30))
