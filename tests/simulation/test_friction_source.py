"""Simulated presses with friction: frames that follow from each other, and their truth."""

from dataclasses import fields

import numpy as np
import pytest

from bubbleviz.api.simulating import Simulation, simulate
from bubbleviz.errors import InputError
from bubbleviz.membrane import build_mesh
from bubbleviz.recordings import Recording
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Camera, Membrane, Pneumatics, Sensor, sensor_to_toml
from bubbleviz.simulation import (
    RecordingWithTruth,
    SyntheticSource,
    Truth,
    press_path,
    read_truth,
    touching_height,
)
from tests.program import output_of

HEIGHT, FRAMES = 0.020, 16
POSE = f"0.002 0 {HEIGHT - 0.004} 0 0 0 1"


@pytest.fixture(scope="module")
def sensor():
    return Sensor(
        name="rubber dome",
        membrane=Membrane(rim_radius_m=0.045, height_m=HEIGHT, nodes=70, prestretch=1.2),
        pneumatics=Pneumatics(gauge_pressure_pa=2500.0, chamber_volume_m3=3e-4),
        camera=Camera(
            width=40, height=30, fx=23.0, fy=19.0, cx=19.5, cy=14.5, position_m=(0.0, 0.0, -0.07)
        ),
    )


def source(sensor, friction, **moved):
    return simulate(sensor, "sphere", POSE, frames=FRAMES, friction=friction, **moved).source


@pytest.fixture(scope="module")
def dragged(sensor):
    return source(sensor, 0.5, drag_m=0.003, twist_rad=np.radians(15.0))


def test_the_path_waits_presses_drags_and_twists(sensor):
    obj, mesh = load_object("sphere"), build_mesh(sensor)
    aim = np.eye(4)
    aim[:3, 3] = 0.002, 0.0, HEIGHT - 0.004
    poses = press_path(obj, aim, mesh, 41, 0.003, 0.3)
    free = poses[:, 2, 3] > [touching_height(obj, pose, mesh) for pose in poses]
    assert free[:6].all() and not free[17:].any()
    still = np.ptp(poses[:7], axis=0)
    assert still.max() == 0.0
    np.testing.assert_allclose(poses[16], aim, atol=1e-12)
    np.testing.assert_allclose(poses[-1][:3, 3], aim[:3, 3] + [0.003, 0.0, 0.0], atol=1e-12)
    assert np.arctan2(poses[-1][1, 0], poses[-1][0, 0]) == pytest.approx(0.3)
    np.testing.assert_array_equal(poses[-1], poses[-3])


def test_ground_truth_has_force_torque_traction_and_slip(dragged):
    truths = [dragged.truth(k) for k in range(FRAMES)]
    assert np.isnan(truths[0].slip_share) and np.abs(truths[0].torque_nm).max() == 0.0
    pressed = next(k for k in range(FRAMES) if dragged.poses[k, 0, 3] > 0.002 + 1e-9) - 1
    moved = next(k for k in range(FRAMES) if abs(dragged.poses[k, 1, 0]) > 1e-9) - 1
    assert truths[pressed].force_n[0] < 0.05 * truths[moved].force_n[0]
    assert truths[moved].slip_share > 0.1  # 3 mm is more than 0.5 holds
    assert truths[-1].torque_nm[2] > 10 * abs(truths[moved].torque_nm[2])
    assert truths[-1].slip_share == 0.0  # it holds
    mesh = dragged.mesh
    for k in (moved, FRAMES - 1):
        truth = truths[k]
        x = mesh.deformed(truth.displacement_3d_m)
        areas = type(mesh)(x, mesh.triangles, mesh.rim).areas[:, None]
        nodal = truth.traction_pa * areas
        np.testing.assert_allclose(nodal.sum(axis=0), truth.force_n, atol=1e-9)
        about = np.cross(x - truth.center_of_pressure_m, nodal).sum(axis=0)
        np.testing.assert_allclose(about, truth.torque_nm, atol=1e-9)


def test_frames_are_the_same_in_any_order(sensor, dragged):
    again = source(sensor, 0.5, drag_m=0.003, twist_rad=np.radians(15.0))
    for k in (9, 2, 12):
        np.testing.assert_array_equal(again[k].depth_m, dragged[k].depth_m)
    again.close()
    np.testing.assert_array_equal(again[9].depth_m, dragged[9].depth_m)


def test_zero_friction_equals_the_frictionless_simulation(sensor):
    aim = np.eye(4)
    aim[:3, 3] = 0.002, 0.0, HEIGHT - 0.004
    without = SyntheticSource(sensor, load_object("sphere"), aim[None], model="rubber")
    zero = SyntheticSource(sensor, load_object("sphere"), aim[None], friction=0.0)
    one, two = without.truth(0), zero.truth(0)
    for field in fields(Truth):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(two, field.name))
    assert np.isnan(two.slip_share) and np.isnan(two.slip_m).all()


def test_recording_and_ground_truth_of_the_command(sensor, dragged, tmp_path):
    """By the former options in millimetres and degrees."""
    file = tmp_path / "sensor.toml"
    file.write_text(sensor_to_toml(sensor))
    rec, truth = tmp_path / "drag.mcap", tmp_path / "drag.npz"
    words = ["simulate", "--sensor", file, "--object", "sphere", "--pose", POSE]
    words += ["--frames", FRAMES, "--friction", 0.5, "--drag", 3, "--twist", 15]
    output_of(*words, "--out", rec, "--truth", truth)
    known = RecordingWithTruth(Recording(rec), truth)
    assert len(known) == FRAMES
    for k in (0, 8, FRAMES - 1):
        for field in fields(Truth):
            np.testing.assert_array_equal(
                getattr(known.truth(k), field.name), getattr(dragged.truth(k), field.name)
            )
    known.close()


def test_ground_truth_without_friction_is_read(sensor, tmp_path):
    whole, old = tmp_path / "whole.npz", tmp_path / "old.npz"
    press = SyntheticSource(sensor, load_object("sphere"), np.eye(4)[None] + 0.0)
    press.poses[0, 2, 3] = HEIGHT
    Simulation(press).save(tmp_path / "rec.mcap", whole)
    new = ("traction_pa", "torque_nm", "slip_m", "slip_share")
    with np.load(whole) as file:
        np.savez(old, **{key: file[key] for key in file.files if key not in new})
    assert not set(new) & read_truth(old).keys()
    known = RecordingWithTruth(Recording(tmp_path / "rec.mcap"), old)
    assert known.truth(0).traction_pa is None and known.truth(0).force_n.shape == (3,)
    known.close()


def test_drag_along_a_path_is_refused(sensor, tmp_path):
    with pytest.raises(InputError, match="a single pose"):
        simulate(sensor, "sphere", np.eye(4)[None], frames=20, drag_m=0.001)
