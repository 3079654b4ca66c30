"""The zero of the gas pressure: learned at rest, kept across sensor files, reset."""

from dataclasses import replace

import numpy as np
import pytest
from small_press import record, small_source

import bubbleviz as bv
from bubbleviz.errors import InputError
from bubbleviz.recordings import Frame
from bubbleviz.zeros import SKIPPED, ZERO_FRAMES, PressureZero

PNEUMATICS = bv.load_sensor("pico_flexx_75mm").pneumatics.model_copy(
    update={"atmospheric_pressure_pa": 101_000.0}
)
OTHER = PNEUMATICS.model_copy(update={"gauge_pressure_pa": PNEUMATICS.gauge_pressure_pa + 1000.0})
REFERENCE = PNEUMATICS.reference_pressure_pa


def learned(pressures):
    zero = PressureZero(PNEUMATICS)
    for pressure in pressures:
        zero.learn(pressure, contact_free=True)
    return zero


def frame(pressure):
    return Frame(0, 0.0, np.zeros((2, 2), np.float32), gas_pressure_pa=pressure)


def test_median_at_rest_is_subtracted_from_every_pressure():
    pressures = REFERENCE + 250.0 + np.arange(ZERO_FRAMES) ** 2
    unknown = learned(pressures[:-1]).applied(frame(REFERENCE))
    assert unknown.gas_pressure_pa == REFERENCE
    assert 1.96 * unknown.gas_sigma_pa == pytest.approx(2e3)  # of the weather
    zero = learned(pressures)
    assert not zero.waiting
    assert zero.applied(frame(REFERENCE)).gas_sigma_pa == 0.0
    assert zero.rest_pa == np.median(pressures)
    shifted = zero.applied(frame(np.median(pressures) + 30.0)).gas_pressure_pa
    assert shifted == pytest.approx(REFERENCE + 30.0)
    assert zero.applied(frame(None)).gas_pressure_pa is None
    for _ in range(ZERO_FRAMES):  # nothing is learned that was not asked for
        zero.learn(0.0, contact_free=True)
    assert zero.rest_pa == np.median(pressures)


def test_an_interrupted_contact_free_run_starts_again():
    zero = learned(np.full(ZERO_FRAMES - 1, REFERENCE + 900.0))
    zero.learn(None, contact_free=False)  # without a pressure there is nothing to tell
    assert zero.wants_next()
    zero.learn(REFERENCE + 900.0, contact_free=False)
    assert [zero.wants_next() for _ in range(SKIPPED)] == [False] * (SKIPPED - 1) + [True]
    for k in range(ZERO_FRAMES):
        assert zero.offset_pa is None
        zero.learn(REFERENCE - 70.0, contact_free=True)
        assert zero.waiting is (k < ZERO_FRAMES - 1)
    assert zero.offset_pa == pytest.approx(-70.0)
    assert not zero.wants_next()
    zero.zero_now()
    assert zero.waiting and zero.offset_pa == pytest.approx(-70.0)  # till there is another
    for _ in range(ZERO_FRAMES):
        zero.learn(REFERENCE - 90.0, contact_free=True)
    assert zero.offset_pa == pytest.approx(-90.0)


def test_another_sensor_file_keeps_the_measured_rest_and_waits_again():
    zero = learned(np.full(ZERO_FRAMES, REFERENCE + 250.0))
    zero.refer_to(PNEUMATICS)
    assert not zero.waiting
    zero.refer_to(OTHER)
    assert zero.waiting
    assert zero.rest_pa == REFERENCE + 250.0
    assert zero.applied(frame(REFERENCE + 250.0)).gas_pressure_pa == REFERENCE + 1000.0
    fresh = PressureZero(PNEUMATICS)
    fresh.refer_to(OTHER)
    assert fresh.rest_pa is None and fresh.offset_pa is None


@pytest.mark.parametrize(
    ("rest_pa", "used"), [(80e3, True), (2_500.0, True), (0.37, False), (2.6, False)]
)
def test_only_absolute_and_gauge_pressures_in_pascal_are_used(rest_pa, used):
    """0.37 psi and 2.6 kPa are gauge pressures in other units: their changes are far too small."""
    zero = learned(np.full(ZERO_FRAMES, rest_pa))
    assert zero.applied(frame(rest_pa)).gas_pressure_pa == (REFERENCE if used else None)


def test_zero_can_be_restored():
    zero = PressureZero(PNEUMATICS)
    zero.restore(REFERENCE - 40.0, waiting=False)
    assert zero.offset_pa == -40.0 and zero.rest_pa == REFERENCE - 40.0 and not zero.waiting
    zero.restore(None, waiting=True)
    assert zero.offset_pa is None and zero.waiting


@pytest.mark.parametrize("missing", [0, -1])
def test_a_recording_whose_pressure_starts_late_or_ends_early_is_zeroed(sensor, missing):
    source = small_source(sensor, heights=(*4 * (0.06,), 0.042))
    whole = [replace(each, gas_pressure_pa=each.gas_pressure_pa + 1500.0) for each in source]
    frames = list(whole)
    frames[missing] = replace(frames[missing], gas_pressure_pa=None)
    run = bv.estimate(frames, sensor)
    assert run.context["gas_zero"] == "gas pressure zero: +1500 Pa from " + (
        "3 contact-free frames" if missing == 0 else "4 contact-free frames"
    )
    assert run.context["gas_zero"] in run.to_text()
    assert float(run.provenance["gas_pressure_offset_pa"]) == pytest.approx(1500.0, abs=1.0)
    known_n = bv.estimate(whole, sensor)[-1].force_n
    assert np.linalg.norm(run[-1].force_n - known_n) < 0.01 * np.linalg.norm(known_n)
    far = [replace(each, gas_pressure_pa=each.gas_pressure_pa + 5000.0) for each in source]
    assert bv.estimate(far, sensor).status[0] == "no_contact"
    with pytest.raises(InputError, match="check the gas pressure"):  # as it is believed
        bv.estimate(far, sensor, zero_gas=False)


def test_contact_free_frames_of_another_shape_give_no_zero_and_the_sensor_file_is_named(sensor):
    source = small_source(sensor, heights=6 * (0.06,))
    bent = 0.004 * np.linspace(-1.0, 1.0, source[0].depth_m.shape[1]) ** 2
    frames = [replace(f, depth_m=(f.depth_m + bent).astype(np.float32)) for f in source]
    run = bv.estimate(frames, sensor)
    assert set(run.status) == {"no_contact"}
    assert "contact-free frames in a row fit the sensor file" in run.context["gas_zero"]


@pytest.mark.parametrize("pressed", [True, False])
def test_a_pressure_sensor_that_repeats_one_value_is_not_used(tmp_path, sensor, pressed):
    """Its p_v of zero in a press would make the force too large; the gas law gives p_v instead."""
    source = small_source(sensor, heights=(*16 * (0.06,), *3 * (0.042 if pressed else 0.06,)))
    frozen, unrecorded = (
        bv.estimate(
            record(tmp_path / f"{name}.mcap", (replace(f, gas_pressure_pa=gas) for f in source)),
            sensor,
        )
        for name, gas in (("frozen", REFERENCE), ("unrecorded", None))
    )
    assert ("never changes, not even by contact" in (frozen.warning or "")) == pressed
    assert unrecorded.context["gas_zero"] is None
    assert "gas_pressure_offset_pa" not in unrecorded.provenance
    np.testing.assert_array_equal(frozen.force_n, unrecorded.force_n)
    assert (np.linalg.norm(frozen.force_n[-1]) > 1.0) == pressed
