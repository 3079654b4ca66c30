"""Another atmospheric pressure changes no force, or the interval covers the change."""

from dataclasses import replace

import numpy as np
import pytest

import bubbleviz as bv
from bubbleviz.membrane import RubberForward
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import HeldFrames, Recording
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import load_sensor
from bubbleviz.sensor_model import SensorModel
from bubbleviz.zeros import zeros_of
from tests.membrane.domes import pose
from tests.rubber_renders import camera_of, dome_sensor, render
from tests.small_press import changed

REST, HELD = 6, 3
AIR_PA = 98_700.0  # of the place


def shifted(frames, shift_pa):
    return [replace(each, gas_pressure_pa=each.gas_pressure_pa + shift_pa) for each in frames]


@pytest.fixture(scope="module")
def twin():
    """A rubber dome that a ball is pressed into: sensor, frames at rest and in contact, force."""
    sensor = dome_sensor(camera_of(160, 107.5), atmosphere_pa=AIR_PA)
    sensor = changed(sensor, membrane={"prestretch": 1.2, "nodes": 500})
    model = SensorModel.of(sensor, nodes=1500)
    ball = load_object("sphere")
    top = model.mesh.nodes[:, 2].max() - ball.vertices[:, 2].min()
    press = RubberForward(model.rubber, model.gas).press(ball, pose(0.006, -0.004, top - 0.007))
    assert press.converged
    shapes = np.stack([model.mesh.nodes, model.mesh.nodes + press.displacement_3d_m])
    gauge = sensor.pneumatics.gauge_pressure_pa + np.array([0.0, press.gas_pressure_change_pa])
    times = np.repeat([0, 1], [REST, HELD])
    frames = render(
        "press", sensor.camera, shapes[times], model.mesh.triangles, gauge[times],
        atmosphere_pa=AIR_PA,
    )  # fmt: skip
    return sensor, list(frames), press.nodal_force_n.sum(axis=0)


@pytest.fixture(scope="module")
def usual(twin):
    """The run on a day of the sensor file's weather."""
    sensor, frames, _ = twin
    return bv.estimate(frames, sensor)


def test_contact_free_frames_set_the_zero(twin, usual):
    sensor, frames, _ = twin
    run = bv.estimate(shifted(frames, 3000.0), sensor)
    assert list(run.status) == list(usual.status) == ["no_contact"] * REST + ["ok"] * HELD
    np.testing.assert_allclose(run.force_n, usual.force_n, atol=1e-6)


@pytest.mark.parametrize("shift_pa", [3000.0, -1000.0])
def test_interval_covers_the_force_without_contact_free_frames(twin, usual, shift_pa):
    sensor, frames, force = twin
    pipeline = Pipeline.of(sensor)
    held = shifted(frames[REST:], shift_pa)
    zero = zeros_of(HeldFrames(held), pipeline).gas
    assert zero.offset_pa is None and "±2 kPa" in zero.words
    for frame, before in zip(held, usual[REST:], strict=True):
        estimate = pipeline.process(zero.applied(frame), frozenset({"estimate"})).estimate
        assert estimate.status == "ok"
        size = np.linalg.norm(estimate.force_n)
        assert abs(size - np.linalg.norm(before.force_n)) < estimate.force_half_width_n
        assert size == pytest.approx(np.linalg.norm(force), rel=0.05)


def test_standard_atmosphere_leaves_the_altitude_open(twin, usual):
    """A file that names no place, used 225 m up, without frames to find the zero by."""
    sensor, frames, _ = twin
    nowhere = changed(sensor, pneumatics={"atmospheric_pressure_pa": 101_325.0})
    pipeline = Pipeline.of(nowhere)
    zero = zeros_of(HeldFrames(frames[REST:]), pipeline).gas
    assert zero.offset_pa is None and "±10 kPa of weather and altitude" in zero.words
    for frame, before in zip(frames[REST:], usual[REST:], strict=True):
        estimate = pipeline.process(zero.applied(frame), frozenset({"estimate"})).estimate
        assert estimate.status == "ok"
        change = np.linalg.norm(estimate.force_n) - np.linalg.norm(before.force_n)
        assert abs(change) < estimate.force_half_width_n


def test_constant_contact_is_not_contact_free(twin):
    """The ball lies on the dome from the first frame to the last, and its pressure never moves."""
    sensor, frames, _ = twin
    held = [replace(frames[REST + k % HELD], index=k) for k in range(20)]
    run = bv.estimate(held, sensor)
    assert set(run.status) == {"ok"}
    zero = zeros_of(HeldFrames(held), Pipeline.of(sensor)).gas
    assert zero.offset_pa is None


def test_a_rest_late_in_a_recording_is_found(twin):
    """Contact first, in any number of frames: the zero is looked for all along."""
    sensor, frames, _ = twin
    late = [frames[REST + k % HELD] for k in range(30)] + [frames[k % REST] for k in range(8)]
    pipeline = Pipeline.of(sensor)
    zero = zeros_of(HeldFrames(shifted(late, 998.0)), pipeline).gas
    assert zero.offset_pa == pytest.approx(998.0, abs=3.0)
    assert zero.words.startswith("gas pressure zero: +99") and "contact-free frames" in zero.words


@pytest.mark.long  # in short: of the twin, above
@pytest.mark.parametrize("rest", [True, False])
def test_weather_of_the_real_press(punyo_press, rest):
    """As on its own day; 1 kPa more made 7.75 N of it, believed to 0.24 N."""
    sensor, chosen = load_sensor("punyo_oval_d405"), [*range(4 * rest), 75, 84]
    with Recording(punyo_press) as recording:
        frames = [recording[k] for k in chosen]
    usual = bv.estimate(frames, sensor)
    run = bv.estimate(shifted(frames, -1000.0), sensor)
    for k in range(len(chosen) - 2, len(chosen)):
        size, before = (np.linalg.norm(each.force_n[k]) for each in (run, usual))
        assert run.status[k] == "ok"
        assert abs(size - before) < run[k].estimate.force_half_width_n
        assert size == pytest.approx(2.93, abs=0.1)
