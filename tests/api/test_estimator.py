"""`Estimator` fed image by image, against `estimate` of the same frames."""

import time
from dataclasses import replace

import numpy as np
import pytest
from small_press import HEIGHTS

import bubbleviz as bv
from bubbleviz.sensor import load_sensor
from bubbleviz.zeros import SKIPPED, ZERO_FRAMES
from tests.small_press import changed, coarser

SHAPE = (43, 56)


@pytest.fixture(scope="module")
def frames(press):
    return list(bv.open(press))


@pytest.fixture(scope="module")
def estimator(sensor):
    return bv.Estimator(sensor, zero_gas=False)


@pytest.fixture(autouse=True)
def fresh(estimator):
    estimator.reset()


def given_as(frame):
    return {"gas_pressure_pa": frame.gas_pressure_pa, "time_s": frame.time_s}


def assert_same(found, run):
    """Every number of every frame, but the times it took, to the last digit."""
    for one, other in zip(found, run, strict=True):
        assert one.status == other.status and one.time_s == pytest.approx(other.time_s, abs=1e-6)
        for name in ("force_n", "force_sigma_n", "contact_pressure_pa", "nodes_m", "pixel_mask"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def test_arrays_and_frames_give_the_same_result_as_the_recording(frames, sensor, estimator):
    run = bv.estimate(frames, sensor, zero_gas=False)
    assert {"ok", "no_contact"} == set(run.status)
    assert_same([estimator.update(each.depth_m, **given_as(each)) for each in frames], run)
    estimator.reset()
    assert_same([estimator.update(frame) for frame in frames], run)


@pytest.mark.long  # in short: of arrays, above
def test_frames_of_the_real_press_give_the_same_result_as_the_recording(punyo_press):
    """Its camera info is not quite the sensor file's."""
    press = [bv.open(punyo_press)[k] for k in range(76, 80)]  # alone, so without zeros
    run = bv.estimate(press, "punyo_oval_d405", zero_gas=False)
    estimator = bv.Estimator("punyo_oval_d405", zero_gas=False)
    assert_same([estimator.update(frame) for frame in press], run)
    assert run[-1].status == "ok"


def test_millimetres_and_missing_returns(frames, sensor, estimator):
    depth_mm = np.nan_to_num(np.round(1e3 * frames[2].depth_m)).astype(np.uint16)
    depth_mm[:2, :5] = 0
    metres = (depth_mm * np.float32(1e-3)).astype(np.float32)
    metres[depth_mm == 0] = np.nan
    expected = bv.estimate(replace(frames[2], depth_m=metres, gas_pressure_pa=None), sensor)
    zeros = np.nan_to_num(metres).astype(np.float64)
    for given in (depth_mm, depth_mm.astype(np.int64), metres, zeros):
        estimator.reset()
        np.testing.assert_array_equal(estimator.update(given).force_n, expected.force_n)
    assert expected.status == "ok"


def test_result_has_the_time_of_its_image(frames, estimator):
    """Times since 1970 are this computer's, small ones some other clock's."""
    began_s = time.time() - 2.0
    for k in range(2):
        found = estimator.update(frames[0].depth_m, time_s=began_s + 0.125 * k)
        assert found.time_s == pytest.approx(0.125 * k, abs=1e-6)
        assert found.stamp_ns == pytest.approx(1e9 * (began_s + 0.125 * k), abs=1000)
        assert found.age_s > 2.0 - 0.125 * k
    for given in ({"time_s": 77.0}, {}):
        estimator.reset()
        before_s = time.time()
        found = estimator.update(frames[0].depth_m, **given)
        assert 0.0 < found.age_s < time.time() - before_s + 1e-3 and found.time_s == 0.0
    assert np.isnan(bv.estimate(frames[0], estimator.solver.pipeline.model.sensor).age_s)


def test_gas_pressure_is_zeroed_on_contact_free_images(frames, sensor):
    """Another day's weather, 800 Pa less, is neither contact nor force."""
    estimator, free, pressed = bv.Estimator(sensor), frames[0], frames[2]
    zero = estimator.solver.zeros.gas
    for _ in range(ZERO_FRAMES):
        estimator.update(pressed.depth_m, pressed.gas_pressure_pa - 800.0)
    assert zero.offset_pa is None
    for _ in range(SKIPPED + ZERO_FRAMES):
        found = estimator.update(free.depth_m, free.gas_pressure_pa - 800.0)
        assert found.status == "no_contact"
    assert zero.offset_pa == pytest.approx(-800.0, abs=1.0)
    found = estimator.update(pressed.depth_m, pressed.gas_pressure_pa - 800.0)
    expected = bv.estimate([free, pressed], sensor, zero_gas=False)[1]
    np.testing.assert_allclose(found.force_n, expected.force_n, atol=0.02)


def test_live_pressure_sensor_that_repeats_one_value_is_not_used(frames, sensor):
    """It is noticed after half a second in contact, and again used when it changes."""
    estimator, free, pressed = bv.Estimator(sensor), frames[0], frames[2]
    for _ in range(ZERO_FRAMES):
        estimator.update(free.depth_m, free.gas_pressure_pa)
    for _ in range(ZERO_FRAMES):
        estimator.update(pressed.depth_m, free.gas_pressure_pa)
    assert "in the source never changes" in " ".join(estimator.solver.warnings())
    repeated = estimator.update(pressed.depth_m, free.gas_pressure_pa)
    unmeasured = bv.estimate([free, replace(pressed, gas_pressure_pa=None)], sensor)[1]
    np.testing.assert_allclose(repeated.force_n, unmeasured.force_n, atol=0.02)
    estimator.update(pressed.depth_m, pressed.gas_pressure_pa)
    assert "never changes" not in " ".join(estimator.solver.warnings())


def test_colour_without_friction_is_refused(sensor):
    rubber = changed(load_sensor(sensor), membrane={"prestretch": 1.2})
    with pytest.raises(bv.InputError, match="--shear measures friction by colour images"):
        bv.Estimator(rubber, shear=True, friction=0.0)


def test_object_is_tracked(frames, sensor):
    estimator = bv.Estimator(sensor, object="cylinder", init="0.005 0 0.044 0 0 0 1")
    heights = [estimator.update(frame).T_B_O[2, 3] for frame in frames[:4]]
    np.testing.assert_allclose(heights[2:], HEIGHTS[2:4], atol=1e-3)
    estimator.reset()
    assert estimator.update(frames[0]).pose.status == "no_contact"


@pytest.mark.parametrize(
    ("depth", "says"),
    [
        (
            np.zeros((56, 43)),
            r"depth: expected an array \(43, 56\) of floats in m or integers in mm",
        ),
        (np.zeros((1, *SHAPE)), r"this is float64 \(1, 43, 56\)"),
        (np.zeros(SHAPE, bool), r"this is bool \(43, 56\)"),
        (
            np.full(SHAPE, 140.0),
            "depth: 140 m in the median, .* give floats in m or integers in mm",
        ),
        (np.full(SHAPE, 1400, np.uint16), "depth: 1.4 m in the median"),
        ([["far"]], "depth: expected an array"),
    ],
)
def test_depth_of_wrong_shape_type_or_unit_gives_one_sentence(depth, says, estimator):
    with pytest.raises(bv.InputError, match=says) as error:
        estimator.update(depth)
    assert "\n" not in str(error.value)


def test_damaged_image_of_a_known_unit_gives_a_status(frames, estimator):
    """One such image must not end a robot's loop."""
    assert estimator.update(frames[0].depth_m).status == "no_contact"
    assert estimator.update(np.full(SHAPE, 140.0)).status not in ("ok", "no_contact")


@pytest.mark.parametrize("pressure", [2585.0, 103.9, 0.0, np.float32(-1.0)])
def test_gas_pressure_not_absolute_or_not_in_pascals_is_refused(pressure, frames, estimator):
    with pytest.raises(bv.InputError, match=r"expected the absolute pressure in Pa, near 1039"):
        estimator.update(frames[0].depth_m, gas_pressure_pa=pressure)


def test_other_invalid_arguments(frames, estimator):
    for given in ({"gas_pressure_pa": float("nan")}, {"gas_pressure_pa": "1e5"}, {"time_s": "now"}):
        with pytest.raises(bv.InputError, match=f"{next(iter(given))}: expected a finite number"):
            estimator.update(frames[0].depth_m, **given)
    with pytest.raises(bv.InputError, match=r"colour: expected an array \(43, 56, 3\) of uint8"):
        estimator.update(frames[0].depth_m, colour=np.zeros(SHAPE))
    with pytest.raises(bv.InputError, match="a Frame already contains gas pressure"):
        estimator.update(frames[0], gas_pressure_pa=103_900.0)


def test_path_in_place_of_a_recording(sensor, press, tmp_path):
    opened, by_path = bv.estimate(bv.open(press), sensor), bv.estimate(str(press), sensor)
    assert_same(by_path, opened)
    assert len(bv.track(press, "cylinder", sensor, init="0.005 0 0.044 0 0 0 1")) == len(HEIGHTS)
    exported, path = bv.export(press, tmp_path / "table.csv", sensor), tmp_path / "table.csv"
    assert exported.frames == len(HEIGHTS)
    assert repr(exported) == f"<{path}: table of {len(HEIGHTS)} frames, 1 file>"
    with pytest.raises(bv.InputError, match=r"nowhere\.mcap"):
        bv.estimate("nowhere.mcap", sensor)
    with pytest.raises(bv.InputError, match=r"use bv\.Estimator for arrays"):
        bv.estimate(np.zeros(SHAPE), sensor)


def test_colour_arrays_give_the_same_traction_as_frames_with_colour():
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    given = bv.load_sensor("pico_flexx_75mm")
    rubber = changed(given, membrane={"nodes": 200, "prestretch": 1.2}, camera=coarser(given, 2))
    free, pressed = (
        bv.simulate(
            rubber, "cylinder", f"0 0 {height} 0 0 0 1", frames=1, friction=0.8, texture=True
        )[0]
        for height in (0.060, 0.046)
    )
    by_array, by_frame = (bv.Estimator(rubber, shear=True) for _ in range(2))
    for k in range(26):
        image = replace(pressed if k == 25 else free, index=k, time_s=k / 30.0)
        one = by_array.update(image.depth_m, image.gas_pressure_pa, image.colour.rgb(), k / 30.0)
        other = by_frame.update(image)
    assert one.result.flow is not None and one.result.traction is not None
    assert one.result.traction.status == "ok"
    # their times differ by rounding, and with them how well the errors of the image are known
    assert one.force_n == pytest.approx(other.force_n, abs=1e-9)
    assert one.force_magnitude_n > 1.0
