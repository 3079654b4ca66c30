"""`bubbleviz simulate`: files contain what was solved; bad input writes nothing."""

import numpy as np
import pytest
import trimesh

from bubbleviz.camera import DepthCamera
from bubbleviz.files import presets_folder
from bubbleviz.recordings import Recording
from bubbleviz.sensor import load_sensor, sensor_to_toml
from bubbleviz.simulation import resized, with_nodes
from tests.program import output_of, refusal

POSE = "0.004 0 0.040 0 0 0 1"


@pytest.fixture(scope="module")
def sensor_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("sensor") / "small.toml"
    path.write_text(
        sensor_to_toml(with_nodes(resized(load_sensor("pico_flexx_75mm"), 64, 48), 600))
    )
    return path


def words_of(sensor_file, folder, *arguments):
    return "simulate", "--sensor", sensor_file, "--out", folder / "out.mcap", *arguments


def test_path_of_poses_gives_frames_and_ground_truth(sensor_file, tmp_path):
    poses = tmp_path / "poses.csv"
    poses.write_text(
        "frame,time_s,x_m,y_m,z_m,qx,qy,qz,qw\n"
        "0,0.0,0,0,0.060,0,0,0,1\n1,0.1,0,0,0.045,0,0,0,1\n2,0.25,0,0,0.040,0,0,1,0\n"
    )
    truth = tmp_path / "truth.npz"
    both = ("--pose", "0 0 1 0 0 0 1", "--path", poses)  # the path counts
    told = output_of(
        *words_of(sensor_file, tmp_path, "--object", "sphere", *both, "--truth", truth)
    )
    recording = Recording(tmp_path / "out.mcap")
    data = np.load(truth)
    force = np.linalg.norm(data["force_n"], axis=1).max()
    assert told == f"wrote   {tmp_path / 'out.mcap'}: 3 frames, largest force {force:.3g} N\n"
    np.testing.assert_allclose(recording.times_s, [0.0, 0.1, 0.25], atol=1e-6)
    assert data["status"].tolist() == ["no_contact", "ok", "ok"]
    assert data["patch_mask"].shape == (3, 48, 64)
    assert data["displacement_m"].shape == (3, len(data["nodes_m"]))
    p0 = 101325.0 + 2585.5
    for k in range(3):
        assert recording[k].gas_pressure_pa == pytest.approx(
            p0 + data["gas_pressure_change_pa"][k], abs=1e-3
        )
    # what the camera sees inside the patch lies on the ball, to the mesh's coarseness
    mask = data["patch_mask"][2]
    camera = DepthCamera.of(load_sensor(sensor_file).camera)
    points = camera.points(recording[2].depth_m, np.flatnonzero(mask))
    radius = np.linalg.norm(points - [0.0, 0.0, 0.040 + 0.015], axis=1)
    assert mask.sum() >= 10
    assert np.abs(radius - 0.015).mean() < 1.5e-4  # chords of 3 mm edges sink 0.1 mm in
    recording.close()


def test_an_object_that_touches_nothing_is_told(sensor_file, tmp_path):
    above = "--object", "sphere", "--pose", "0 0 0.060 0 0 0 1", "--frames", 2
    told = output_of(*words_of(sensor_file, tmp_path, *above))
    assert told.endswith("out.mcap: 2 frames, the object touches nothing\n")


def test_unit_of_the_mesh_file_option(sensor_file, tmp_path):
    sphere = trimesh.load_mesh(presets_folder("objects") / "sphere.ply")
    sphere.apply_scale(1e3).export(tmp_path / "cad.stl")
    options = "--pose", POSE, "--object", tmp_path / "cad.stl"
    assert "--unit mm" in refusal(*words_of(sensor_file, tmp_path, *options))
    told = output_of(*words_of(sensor_file, tmp_path, *options, "--unit", "mm"))
    assert "largest force" in told  # of metres, it would be below the dome or its unit refused


def depths(sensor_file, folder, *options):
    folder.mkdir()
    output_of(*words_of(sensor_file, folder, "--object", "sphere", "--pose", POSE, *options))
    recording = Recording(folder / "out.mcap")
    depth = recording[0].depth_m
    recording.close()
    return depth


def test_noise_is_reproducible_by_seed(sensor_file, tmp_path):
    images = [
        depths(sensor_file, tmp_path / name, "--noise-sigma", 0.001, "--seed", seed)
        for name, seed in (("a", 1), ("b", 1), ("c", 2))
    ]
    np.testing.assert_array_equal(images[0], images[1])
    assert np.nanstd(images[0] - images[2]) > 5e-4


def test_squares_of_absolute_and_relative_noise_add(sensor_file, tmp_path):
    quiet = depths(sensor_file, tmp_path / "quiet")
    both = depths(sensor_file, tmp_path / "both", "--noise-sigma", 0.001, "--noise-relative", 0.02)
    wanted = np.sqrt(np.nanmean(0.001**2 + (0.02 * quiet) ** 2))
    assert np.nanstd(both - quiet) == pytest.approx(wanted, rel=0.1)
