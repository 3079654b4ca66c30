"""The speckle moves with the material, so that optical flow of its images finds what moved."""

from dataclasses import replace

import numpy as np
import pytest

from bubbleviz.api.simulating import Simulation
from bubbleviz.camera import DepthCamera, Intrinsics, MembraneView
from bubbleviz.files import parse_pose
from bubbleviz.membrane import build_mesh
from bubbleviz.recordings import Recording
from bubbleviz.rigid_object import load_object
from bubbleviz.sensor import Sensor, load_sensor
from bubbleviz.simulation import PrintedMembrane, SyntheticSource

WIDTH, HEIGHT, REST = 320, 240, 8


@pytest.fixture(scope="module")
def view():
    """The dome of the preset in a camera with 320×240 pixels."""
    sensor: Sensor = load_sensor("pico_flexx_75mm")
    camera = Intrinsics(WIDTH, HEIGHT, 270.0, 270.0, 159.5, 119.5)
    return MembraneView(DepthCamera(camera, sensor.camera.T_B_C), build_mesh(sensor))


def dragged(view, far_m):
    """Displacement (n, 3) of a drag in x, a turn about z and a dent, around the apex."""
    x, y, _ = view.mesh.nodes.T
    near = np.exp(-(x**2 + (y - 0.005) ** 2) / (2.0 * 0.02**2))
    turn = 0.5 * far_m / 0.02
    return np.stack([far_m * near - turn * y * near, turn * x * near, -far_m * near], axis=1)


def true_motion(view, moved_m, pixel):
    """Motion (k, 2) in the image of the material that pixels see at rest, pixels."""
    hits = view.hits(np.zeros_like(moved_m), pixel)
    assert len(hits.ray) == len(pixel)
    nodes = view.mesh.nodes[view.mesh.triangles[hits.triangle]]
    moves = moved_m[view.mesh.triangles[hits.triangle]]
    rest, now = (
        view.camera.intrinsics.project(
            (np.einsum("kj,kjx->kx", hits.barycentric, places) - view.camera.center)
            @ view.camera.T_B_C[:3, :3]
        )
        for places in (nodes, nodes + moves)
    )
    return np.asarray(now - rest)


@pytest.mark.parametrize("far_m", [1e-3, 2.5e-3])
def test_flow_finds_the_motion_of_the_material(view, far_m):
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    from bubbleviz.shear import OpticalFlow

    printed, at_rest = PrintedMembrane(view, seed=3), np.zeros_like(view.mesh.nodes)
    seen = np.isfinite(view.range_image(at_rest))
    flow = OpticalFlow.of([printed.image(at_rest, k) for k in range(REST)], seen)
    moved_m = dragged(view, far_m)
    field = flow.measure(printed.image(moved_m, 99))
    truth = true_motion(view, moved_m, field.pixel)
    far_px = np.linalg.norm(truth, axis=1)
    assert 0.5 < far_px.max() / (1e3 * far_m) < 3.0
    assert len(field.pixel) > 0.7 * seen.sum() / 64
    errors = field.moved_px - truth
    assert np.sqrt(np.mean(errors[far_px > 0.5] ** 2)) < 0.1
    assert np.sqrt(np.mean((errors / field.sigma_px[:, None]) ** 2)) < 1.5


def test_light_and_noise_of_the_images(view):
    """Bright where the membrane faces the camera, dark at its rim."""
    at_rest = np.zeros_like(view.mesh.nodes)
    clean, noisy = (PrintedMembrane(view, noise=sigma) for sigma in (0.0, 4.0))
    grey, seen = clean.image(at_rest, 0).astype(float), np.isfinite(view.range_image(at_rest))
    assert grey[seen].min() < 70 < 180 < grey[seen].max()
    assert np.mean(grey[80:160, 120:200]) > 1.1 * np.mean(grey[seen])
    noise = noisy.image(at_rest, 0) - grey
    assert np.std(noise[seen]) == pytest.approx(4.0, rel=0.05)
    np.testing.assert_array_equal(noisy.image(at_rest, 0) - grey, noise)
    assert not np.array_equal(noisy.image(at_rest, 1) - grey, noise)


def test_a_simulated_recording_has_the_images(sensor, tmp_path):
    poses = np.array([parse_pose(f"0.005 0 {z} 0 0 0 1") for z in (0.060, 0.044)])
    source = SyntheticSource(load_sensor(sensor), load_object("cylinder"), poses, texture=True)
    Simulation(source).save(tmp_path / "rec.mcap")
    with Recording(tmp_path / "rec.mcap") as recording:
        for k in range(2):
            made, written = source[k].colour, recording[k].colour
            np.testing.assert_array_equal(written.grey(), made.grey())
            assert written.camera.intrinsics == source.camera.intrinsics
            assert not written.camera.remark
        before = replace(recording[1], colour_delay_s=-1.0 / 30.0).colour
        np.testing.assert_array_equal(before.grey(), source[0].colour.grey())
