"""Check of a sensor file: each change is reported as what it is, without false alarms."""

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from small_press import record

import bubbleviz as bv
from bubbleviz.calibration import check_sensor, write_sensor
from bubbleviz.errors import InputError
from bubbleviz.membrane import Inflation, MembraneMesh, build_rubber
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from tests.program import output_of, refusal
from tests.rubber_renders import GAUGE_PA, at_rest, camera_of, dome_sensor, render, rubber_truth
from tests.small_press import changed

from .identified import identify
from .twin import FREE, cast, make_twin, nominal_sensor

REST = 15
"""Frames at rest that are enough for every verdict."""


@pytest.fixture(scope="module")
def sensor(tmp_path_factory):
    """Of the twin, identified from a recording of another day."""
    found = identify(make_twin(frames=FREE), nominal_sensor(), range(FREE), nodes=400)
    file = tmp_path_factory.mktemp("check") / "twin.toml"
    write_sensor(found, file)
    file.write_text(file.read_text().replace("[membrane]", "[membrane]\nprestretch = 1.3"))
    return load_sensor(file)


@pytest.fixture(scope="module")
def twin():
    return make_twin(noise_seed=1)


@pytest.fixture(scope="module")
def rest(twin):
    return [twin[k] for k in range(REST)]


def with_depth(frames, change):
    return [replace(frame, depth_m=change(frame.depth_m).astype(np.float32)) for frame in frames]


def size_of(found, quantity):
    return next(row.value for row in found.rows if row.quantity == quantity)


def test_the_same_sensor_raises_no_alarm(sensor):
    for seed in range(20 if "TEST_ALL" in os.environ else 2):
        again = make_twin(noise_seed=100 + seed, frames=REST)
        found = bv.check([again[k] for k in range(REST)], sensor)
        assert found.verdict == "fits", found.reason
        assert abs(found.bias_m) < 2e-5


def test_a_camera_noisier_than_its_file_is_not_drift():
    """The error of the flat facets of a sensor file without calibrated pixels is no change."""
    sensor = load_sensor("pico_flexx_75mm")
    sensor = changed(sensor, membrane={"nodes": 600}, camera={"noise_relative": 1e-3})
    far = np.tile(np.eye(4), (REST, 1, 1))
    far[:, 2, 3] = 0.3
    frames = bv.simulate(sensor, "sphere", far, noise_relative=4e-3, seed=3)
    found = bv.check([frames[k] for k in range(REST)], sensor)
    assert found.verdict == "fits", found.reason


def test_weather_is_not_drift(sensor, rest):
    frames = [replace(f, gas_pressure_pa=f.gas_pressure_pa + 1e3) for f in rest]
    found = bv.check(frames, sensor)
    assert found.verdict == "fits"
    assert size_of(found, "gas pressure change measured") == pytest.approx(1e3, abs=20.0)
    frames = [replace(f, gas_pressure_pa=f.gas_pressure_pa + 9e3) for f in rest]
    assert "more than weather" in bv.check(frames, sensor).to_text()


@pytest.mark.parametrize("offset_m", [1.8e-4, pytest.param(-1.8e-4, marks=pytest.mark.long)])
def test_an_offset_of_depth(sensor, rest, offset_m):
    found = bv.check(with_depth(rest, lambda depth: depth + offset_m), sensor)
    assert found.verdict == "drifted"
    assert found.bias_m == pytest.approx(offset_m, abs=2e-5)
    assert found.reason.startswith(f"drifted by {1e3 * found.bias_m:+.2f} mm")
    assert size_of(found, "depth offset") == pytest.approx(offset_m, abs=2e-5)
    assert [row.quantity for row in found.rows if row.todo] == ["depth offset"]
    assert found.force_error_n < 0.05 * found.press_n  # the estimator allows for an offset


def test_an_offset_that_grows_while_it_is_recorded(sensor, rest):
    grows = np.linspace(0.0, 3e-4, REST)
    frames = [
        with_depth([f], lambda z, by=by: z + by)[0] for f, by in zip(rest, grows, strict=True)
    ]
    found = quick_check(sensor, frames)
    assert found.verdict == "drifted", found.reason
    assert found.bias_m == pytest.approx(1.5e-4, abs=2e-5)
    assert [row.quantity for row in found.rows if row.todo] == ["depth offset"]


def test_a_scale_of_depth(sensor, rest):
    found = quick_check(sensor, rest, lambda depth: 1.005 * depth)
    assert found.verdict == "drifted"
    assert size_of(found, "depth scale") == pytest.approx(0.005, abs=5e-4)
    assert [row.quantity for row in found.rows if row.todo] == ["depth scale"]


def test_more_gas_is_detected(sensor, twin, rest):
    """Inflated by 1 kPa, a fifth, simulated on a separate mesh."""
    tension = SensorModel.of(sensor, twin.intrinsics).tension_n_per_m
    rubber = build_rubber(sensor, twin.truth, tension)
    moved = Inflation(rubber).at(rubber.gauge_pressure_pa + 1e3) - twin.truth.nodes
    change = cast(twin.truth, twin.camera, moved) - cast(twin.truth, twin.camera, 0.0 * moved)
    change = np.nan_to_num(twin.camera.depth_image(change))
    frames = [
        replace(f, gas_pressure_pa=f.gas_pressure_pa + 1e3)
        for f in with_depth(rest, lambda depth: depth + change)
    ]
    found = bv.check(frames, sensor)
    assert found.verdict == "drifted" and "inflate" in found.reason
    assert size_of(found, "gas pressure change from the shape") == pytest.approx(1e3, rel=0.1)


@pytest.fixture(scope="module")
def dome(tmp_path_factory):
    """Sensor file of another solver's dome, and its frames at rest or at a level, by seed."""
    truth, camera = rubber_truth("dome_ball"), camera_of(160, 107.5)
    shapes = {"rest": truth["rest_m"], "low": truth["level_m"][0], "high": truth["level_m"][1]}
    pressures = dict(zip(shapes, (GAUGE_PA, *truth["level_pa"]), strict=True))

    def frames(name, seed, gauge_pa=None):
        shape, gauge_pa = at_rest(shapes[name], 10), gauge_pa or pressures[name]
        return render(name, camera, shape, truth["triangles"], gauge_pa, seed=seed)

    levels = [frames("low", 2), frames("high", 3)]
    vented = frames("rest", 4, gauge_pa=1e-9)
    found = identify(frames("rest", 1), dome_sensor(camera), levels=levels, vented=vented)
    file = tmp_path_factory.mktemp("dome") / "dome.toml"
    write_sensor(found, file)
    return load_sensor(file), frames


def quick_check(sensor, source, change=np.asarray):
    """Check of a changed source without the force of a press, which other checks have."""
    frames = with_depth(source, change)
    model = SensorModel.of(sensor, frames[0].intrinsics)
    return check_sensor(model, frames, quick=True)


@pytest.mark.long
@pytest.mark.parametrize(("level", "change_pa"), [("low", -788.7), ("high", 788.7)])
def test_intervals_hold_the_truth_of_another_solver(dome, level, change_pa):
    """Levels of ±15 % of a dome whose stretch is not uniform, with the depth of calibration.

    Errors of its model are a hundredth of a millimetre, and similar to the intervals of those
    quantities that did not change.
    """
    sensor, frames = dome
    found = quick_check(sensor, frames(level, 11))
    assert found.verdict == "drifted" and "inflate the sensor" in found.reason
    *image, gas = found.rows[:7]
    assert abs(gas.value - change_pa) < gas.half_width < 160.0
    assert all(abs(row.value) < 1.5 * row.half_width for row in image), image
    told = [row.quantity for row in found.rows if row.todo]
    assert told == ["gas pressure change from the shape"]


@pytest.mark.long
def test_intervals_hold_two_changes_together(dome):
    """Whose effects are similar: the intervals say that the shape alone hardly tells them apart."""
    sensor, frames = dome
    found = quick_check(sensor, frames("high", 13), lambda depth: depth + 2e-4)
    assert found.verdict == "drifted" and "inflate the sensor" in found.reason
    truth = {"depth offset": 2e-4, "gas pressure change from the shape": 788.7}
    for row in found.rows[:5]:
        assert abs(row.value - truth.get(row.quantity, 0.0)) < row.half_width, row


@pytest.mark.long
def test_two_changes_that_look_like_a_third_are_found_together(dome):
    """An offset and a smaller scale leave about the image of another inflation."""
    sensor, frames = dome
    found = quick_check(sensor, frames("rest", 21), lambda depth: 0.994 * depth + 3e-4)
    told = [row.quantity for row in found.rows if row.todo]
    assert told == ["depth offset", "depth scale"]
    assert abs(size_of(found, "depth scale") + 0.006) < found.rows[3].half_width


@pytest.mark.long
def test_a_measured_gas_pressure_excludes_inflation(dome):
    """A camera displaced along its axis looks like another inflation, but for the gas pressure."""
    sensor, frames = dome
    x, y, z = sensor.camera.position_m
    moved = changed(sensor, camera={"position_m": (x, y, z + 1e-3)})
    found = quick_check(moved, frames("rest", 14))
    assert found.verdict != "fits" and "mounting" in found.reason
    gas = found.rows[6]
    assert not gas.todo and abs(gas.value) < gas.half_width < 130.0


@pytest.mark.long
def test_a_camera_displaced_across_its_axis(dome):
    sensor, frames = dome
    x, y, z = sensor.camera.position_m
    moved = changed(sensor, camera={"position_m": (x - 1e-3, y, z)})
    found = quick_check(moved, frames("rest", 12))
    assert size_of(found, "camera shift to the right") == pytest.approx(1e-3, abs=1e-4)
    told = r"camera shift to the right (0\.9|1\.0)\d* ± 0\.\d+ mm.*: check the camera's mounting"
    assert re.search(told, found.reason)


def test_a_tilt_of_depth(sensor, rest):
    right = (np.arange(160) - 79.5) / 107.5  # tangent of the angle off the optical axis
    found = quick_check(sensor, rest, lambda depth: depth + 3e-4 * right)
    assert found.verdict == "drifted"
    assert size_of(found, "depth tilt to the right, at 45°") == pytest.approx(3e-4, abs=2e-5)
    assert [row.quantity for row in found.rows if row.todo] == ["depth tilt to the right, at 45°"]


def test_another_membrane_is_detected(sensor, twin, rest):
    x, y, z = twin.truth.nodes.T
    bumps = 1e-3 * np.cos(x / 0.008) * np.cos(y / 0.009) * z / z.max()
    other = MembraneMesh(twin.truth.deformed(bumps), twin.truth.triangles, twin.truth.rim)
    nothing = np.zeros(len(x))
    change = cast(other, twin.camera, nothing) - cast(twin.truth, twin.camera, nothing)
    change = np.nan_to_num(twin.camera.depth_image(change))
    found = bv.check(with_depth(rest, lambda depth: depth + change), sensor)
    assert (found.verdict, found.reason) == (
        "another",
        "another membrane or camera, or the camera moved: identify the sensor again",
    )


def test_another_camera_is_detected(sensor, rest):
    wider = [replace(f, intrinsics=replace(f.intrinsics, fx=1.02 * f.intrinsics.fx)) for f in rest]
    found = bv.check(wider, sensor)
    assert found.verdict == "another" and "fx 109.5" in found.reason and "107.4" in found.reason
    bent = {"distortion_model": "plumb_bob", "distortion": (0.05, 0.0, 0.0, 0.0, 0.0)}
    bent = [replace(f, intrinsics=replace(f.intrinsics, **bent)) for f in rest]
    reason = bv.check(bent, sensor).reason
    assert "(distortion plumb_bob 0.05 0 0 0 0)" in reason and "(distortion none)" in reason
    try:  # some of the frames just do, or none
        told = bv.estimate(wider[:3], sensor).warning
    except InputError as error:
        assert "choose the sensor file of this camera" in str(error)
    else:
        assert "camera info differs from the intrinsics in the sensor file" in told
    assert bv.estimate(rest[:3], sensor).warning is None
    found = bv.check(with_depth(rest, lambda depth: depth[::-1, ::-1]), sensor)
    assert found.verdict == "another" and "turned by 180°" in found.reason


def test_the_command_finds_the_frames_itself(sensor, twin, tmp_path):
    recording, file = record(tmp_path / "press.mcap", twin), sensor.resolve(sensor.file)
    words = ("check", recording, "--sensor", file)
    told = json.loads(output_of(*words, "--json"))
    assert told["verdict"] == "fits" and told["frames"][1] <= FREE
    units = {row["quantity"]: row["unit"] for row in told["rows"]}
    assert {unit for name, unit in units.items() if name.startswith("depth")} == {"m", "1"}
    assert units["rest shape, rms"] == "m" and units["gas pressure change from the shape"] == "Pa"
    lines = output_of(*words).splitlines()
    assert lines[0].startswith("fits") and any(line.startswith("depth offset") for line in lines)
    assert "no contact-free frames" in refusal(*words, "--contact-free", "38:45")


@pytest.mark.long  # in short: of the twin, above
def test_the_real_press(punyo_press):
    frames = bv.open(punyo_press)
    rest = [frames[k] for k in range(0, 60, 6)]
    assert bv.check(rest, "punyo_oval_d405").verdict == "fits"
    found = bv.check(with_depth(rest, lambda depth: depth + 1.8e-4), "punyo_oval_d405")
    assert found.verdict == "drifted" and found.force_error_n < 0.1
    with pytest.raises(InputError, match="no contact-free frames"):
        bv.check(frames[72:90], "punyo_oval_d405", contact_free=range(18))
