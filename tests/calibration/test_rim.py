"""The rim in the image against that in the sensor file shows wrong focal lengths and poses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bubbleviz as bv
from bubbleviz.calibration import Ellipsoid, lateral_scale, rim_plane
from bubbleviz.camera import DepthCamera, Intrinsics
from bubbleviz.recordings import HeldFrames, RecordingWriter
from bubbleviz.simulation import DepthNoise
from tests.small_press import changed

from .domes import Dome

RIM, AXES = np.array([0.055, 0.04]), np.array([0.06, 0.0436, 0.03])
CAP = Ellipsoid(np.array([0.0, 0.0, -0.012]), AXES)  # its width at z = 0 is that of the rim


def ring(heights_m=0.0, angles=(0.0, 2.0 * np.pi), count=400):
    """Points of the cap at a height, (count, 3)."""
    turns = np.linspace(*angles, count, endpoint=False)
    wide = np.sqrt(1.0 - ((heights_m - CAP.centre_m[2]) / AXES[2]) ** 2)
    x, y = wide * AXES[0] * np.cos(turns), wide * AXES[1] * np.sin(turns)
    return np.stack([x, y, np.broadcast_to(heights_m, x.shape)], axis=1)


def camera_at(**focal):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [5.0, -8.0, 30.0], degrees=True).as_matrix()
    T[:3, 3] = 0.003, -0.002, -0.06
    values = {"fx": 200.0, "fy": 190.0} | focal
    return DepthCamera(Intrinsics(320, 240, cx=158.0, cy=121.0, **values), T)


def taken_by(points, true, believed):
    """Points as another camera places them, by their pixels and depths."""
    depth, lens = true.local(points)[:, 2], believed.intrinsics
    u, v = true.project(points).T
    local = np.stack([(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, np.ones_like(u)], axis=1)
    return believed.center + depth[:, None] * local @ believed.T_B_C[:3, :3].T


@pytest.mark.parametrize(("fx", "fy"), [(1.0, 1.0), (1.05, 1.05), (0.95, 1.0), (1.0, 1.02)])
def test_scale_along_each_axis_of_the_image_is_that_of_the_focal_length(fx, fy):
    believed = camera_at(fx=200.0 * fx, fy=190.0 * fy)
    moved = ring() + np.array([2e-3, -1e-3, 0.0])  # the drawing is that far off
    scale, sigma = lateral_scale(taken_by(moved, camera_at(), believed), ring(), believed, CAP)
    np.testing.assert_allclose(scale, [fx, fy], atol=1e-3)
    np.testing.assert_allclose(sigma, 0.5e-3 / np.sqrt(3.0) / 0.0475, rtol=0.1)  # of a ruler


def test_occluded_parts_of_the_edge_do_not_change_the_scale():
    edge = np.concatenate([ring(), ring(0.012, (1.0, 2.0), 60)])  # above the rim
    scale, _ = lateral_scale(edge, ring(), camera_at(), CAP)
    np.testing.assert_allclose(scale, 1.0, atol=2e-3)


@pytest.mark.parametrize("height_m", [0.0, 2e-3, 5e-3, -2e-3])
def test_depth_that_ends_beside_the_rim_is_no_other_scale(height_m):
    """Nor is the same edge if the drawing is wrong by that height."""
    for edge in (ring(height_m), ring() + np.array([0.0, 0.0, height_m])):
        scale, sigma = lateral_scale(edge, ring(), camera_at(), CAP)
        assert (np.abs(scale - 1.0) < 1.96 * sigma).all()


@pytest.mark.parametrize("degrees", [0.0, 3.0, 14.0])
def test_wrong_tilt_of_the_camera_is_found_by_the_plane_of_the_rim(degrees):
    true = camera_at()
    T = true.T_B_C.copy()
    T[:3, :3] = Rotation.from_euler("x", degrees, degrees=True).as_matrix() @ T[:3, :3]
    believed = DepthCamera(true.intrinsics, T)
    edge = np.concatenate([ring(), ring(0.012, (1.0, 2.0), 60)])  # a part above the rim
    (centre,) = taken_by(CAP.centre_m[None], true, believed)
    found = rim_plane(taken_by(edge, true, believed), centre, believed)
    assert np.degrees(found.tilt_rad) == pytest.approx(degrees, abs=0.05)
    assert np.degrees(found.sigma_rad) < 1.0
    np.testing.assert_allclose(found.T_B_C, true.T_B_C, atol=2e-4)


def test_depth_that_ends_early_has_no_edge_in_a_plane():
    edge = ring(0.004 * np.sin(np.linspace(0.0, 6.0 * np.pi, 400)))
    assert rim_plane(edge, CAP.centre_m, camera_at()) is None
    assert rim_plane(ring()[:0], CAP.centre_m, camera_at()) is None  # dome beyond the image


def test_a_small_arc_leaves_the_scale_open():
    _, whole = lateral_scale(ring(), ring(), camera_at(), CAP)
    rough = np.random.default_rng(0).normal(0.0, 3e-4, (400, 3))
    _, arc = lateral_scale(ring(angles=(2.0, 3.5)) + rough, ring(), camera_at(), CAP)
    assert (arc > 5.0 * whole).all()
    assert lateral_scale(ring(count=4), ring(), camera_at(), CAP) is None
    assert lateral_scale(np.empty((0, 3)), ring(), camera_at(), CAP) is None


def dome(focal=1.0, seed=0):
    """Frames of a dome whose camera info has a wrong focal length, and the drawing of the dome."""
    radius, height = 0.042, 0.028
    noise, axes = DepthNoise(absolute_m=1e-4), (radius,) * 3
    source = Dome(axes, height, noise, seed, scale=1.0, frames=30, tilt_deg=6.0)
    rim = np.sqrt(radius**2 - (radius - height) ** 2)
    drawn = {"rim_radius_m": round(float(rim), 4), "height_m": height}
    sensor = changed(source.sensor, membrane=drawn, pneumatics={"gauge_sigma_pa": 10.0})
    frames = [source[k] for k in range(len(source))]
    lens = frames[0].intrinsics
    lens = replace(lens, fx=focal * lens.fx, fy=focal * lens.fy)
    return HeldFrames([replace(each, intrinsics=lens) for each in frames], "dome"), sensor


def told(lines):
    return [line for line in lines if line.startswith("The rim in the image")]


def test_a_wrong_focal_length_is_told_by_identify_check_and_estimate(tmp_path):
    """One that is too large: below."""
    frames, sensor = dome(0.95)
    found = bv.identify(frames, sensor, nodes=300, held_press=False)
    numbers = found.save(tmp_path / "wrong.toml", report=tmp_path / "report")
    verdict = numbers["verdict"]
    assert verdict["grade"] != "good"
    assert told(verdict["advice"])
    true, interval = 186.4, numbers["focal_by_rim_px"]["fx"]
    assert interval["low"] < true < interval["high"]
    assert "fx by the size of the rim" in (tmp_path / "report/report.html").read_text()
    with RecordingWriter(tmp_path / "rest.mcap") as writer:
        for k in range(len(frames)):
            writer.write(frames[k])
    check = bv.check(tmp_path / "rest.mcap", tmp_path / "wrong.toml")
    assert check.verdict == "fits"
    with bv.open(tmp_path / "rest.mcap", "0:3") as some:
        run = bv.estimate(some, tmp_path / "wrong.toml")
    for warning in (check.warning, run.warning):
        assert f"fx = {0.95 * true:g} in the sensor file" in warning
        assert "correct the camera info" in warning


def test_the_right_focal_length_is_not_doubted_and_a_wrong_one_not_forgotten(tmp_path):
    frames, sensor = dome()
    right = bv.identify(frames, sensor, nodes=300, held_press=False)
    numbers = right.save(tmp_path / "right.toml")
    assert not told(numbers["verdict"]["advice"])
    first = bv.load_sensor(tmp_path / "right.toml").calibration.fx_interval
    assert first is not None
    # its rim was measured with its focal length, and tells nothing more
    same = bv.identify(frames, tmp_path / "right.toml", nodes=300, held_press=False)
    same.save(tmp_path / "same.toml")
    assert bv.load_sensor(tmp_path / "same.toml").calibration.fx_interval == first
    wrong, _ = dome(1.05)
    bv.identify(wrong, sensor, nodes=300, held_press=False).save(tmp_path / "wrong.toml")
    again = bv.identify(wrong, tmp_path / "wrong.toml", nodes=300, held_press=False)
    assert told(again.save(tmp_path / "again.toml")["verdict"]["advice"])
    corrected = bv.identify(frames, tmp_path / "wrong.toml", nodes=300, held_press=False)
    assert not told(corrected.save(tmp_path / "corrected.toml")["verdict"]["advice"])
