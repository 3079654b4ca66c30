"""The command estimate: from a recording to RESULT.npz, checked against the simulation."""

import json
import os
import tomllib
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import bubbleviz
from bubbleviz.membrane import build_mesh
from bubbleviz.output import FrameTable, ResultWriter
from bubbleviz.recordings import Frame, Recording, RecordingWriter
from bubbleviz.result import Estimate, Patch, Result
from bubbleviz.sensor import load_sensor, sensor_to_toml
from tests.program import facts_of, output_of
from tests.small_press import changed

PRESET = "pico_flexx_75mm"
HEIGHTS = (0.060, 0.042, 0.038, 0.038)
"""Of a cylinder's flat end above the rim: clear of the dome (50 mm high), then pressed in."""


def arrays(path):
    with np.load(path) as file:  # no pickles: RESULT.npz is readable without trust
        return {key: file[key] for key in file.files}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A simulated press with its ground truth and estimate."""
    folder = tmp_path_factory.mktemp("press")
    lines = [f"{0.1 * k},0.01,0.005,{z},0,0,0,1" for k, z in enumerate(HEIGHTS)]
    header = "time_s,x_m,y_m,z_m,qx,qy,qz,qw"
    (folder / "path.csv").write_text("\n".join([header, *lines]))
    output_of(
        "simulate", "--sensor", PRESET, "--object", "cylinder", "--path", folder / "path.csv",
        "--noise-relative", "0.003", "--out", folder / "rec.mcap", "--truth", folder / "truth.npz",
    )  # fmt: skip
    told = output_of(
        "estimate", folder / "rec.mcap", "--sensor", PRESET, "--out", folder / "result.npz",
        "--csv", folder / "result.csv", "--json",
    )  # fmt: skip
    (folder / "told.json").write_text(told)
    return folder


@pytest.fixture(scope="module")
def result(folder):
    return arrays(folder / "result.npz")


@pytest.fixture(scope="module")
def truth(folder):
    return arrays(folder / "truth.npz")


def test_auto_selects_the_preset_with_the_image_size(folder, tmp_path):
    out = tmp_path / "auto.npz"
    output_of("estimate", folder / "rec.mcap", "--sensor", "auto", "--frames", "1:2", "--out", out)
    assert tomllib.loads(str(arrays(out)["sensor_toml"]))["name"] == load_sensor(PRESET).name


def test_result_has_every_documented_key(result):
    frames, (height, width) = len(HEIGHTS), (171, 224)
    nodes, triangles = len(result["nodes_m"]), len(result["triangles"])
    shapes = {
        "frame": (frames,), "time_s": (frames,), "status": (frames,),
        "nodes_m": (nodes, 3), "normals": (nodes, 3), "triangles": (triangles, 3), "rim": (nodes,),
        "displacement_m": (frames, nodes), "contact_pressure_pa": (frames, nodes),
        "gas_pressure_change_pa": (frames,), "force_n": (frames, 3),
        "center_of_pressure_m": (frames, 3), "patch_area_m2": (frames,), "threshold_pa": (frames,),
        "patch_mask": (frames, height, width), "residual_rms_m": (frames,),
        "kkt_residual": (frames,), "solve_ms": (frames,), "total_ms": (frames,),
        "patch_level": (frames, nodes), "displacement_3d_m": (frames, nodes, 3),
        "force_sigma_n": (frames, 3), "torque_sigma_nm": (frames, 3), "measured_force_n": (frames,),
        "normal_force_n": (frames, 3), "tangential_force_n": (frames, 3), "torque_nm": (frames, 3),
        "patch_area_interval_m2": (frames, 2), "kappa": (frames,), "seen_share": (frames,),
        "wrench_n": (frames, 3), "gas_pressure_pa": (frames,), "iterations": (frames,),
        "images": (frames,), "stamp_ns": (frames,), "sensor_toml": (), "version": (), "solver": (),
        "wrench_covariance": (frames, 6, 6),
    }  # fmt: skip
    assert {key: array.shape for key, array in result.items()} == shapes
    kinds = {key: array.dtype.kind for key, array in result.items()}
    texts, flags = {"status", "sensor_toml", "version", "solver"}, {"rim", "patch_mask"}
    whole = {"frame", "triangles", "iterations", "images", "stamp_ns"}
    assert {key for key, kind in kinds.items() if kind == "U"} == texts
    assert {key for key, kind in kinds.items() if kind == "b"} == flags
    assert {key for key, kind in kinds.items() if kind == "i"} == whole
    assert {key for key, kind in kinds.items() if kind == "f"} == set(kinds) - texts - flags - whole
    assert str(result["version"]) == bubbleviz.__version__


def test_contact_is_found_at_its_place(result, truth):
    assert result["status"].tolist() == truth["status"].tolist() == ["no_contact", *["ok"] * 3]
    np.testing.assert_allclose(result["time_s"], truth["time_s"], atol=1e-6)


def test_force_and_centre_are_those_of_the_simulation(result, truth):
    size = np.linalg.norm(truth["force_n"], axis=1)
    assert size[2] > 5.0  # else a few per cent mean nothing
    miss = np.linalg.norm(result["force_n"] - truth["force_n"], axis=1)
    assert np.all(miss[1:] < 0.03 * size[1:])
    away = np.linalg.norm(result["center_of_pressure_m"] - truth["center_of_pressure_m"], axis=1)
    assert np.all(away[1:] < 2e-3)


def test_without_contact_there_is_no_force_and_no_patch(result):
    assert not result["force_n"][0].any()
    assert not result["contact_pressure_pa"][0].any()
    assert not result["patch_mask"][0].any()
    assert result["patch_area_m2"][0] == 0.0
    assert np.isnan(result["center_of_pressure_m"][0]).all()


def test_patch_covers_the_true_contact(result, truth):
    for found, true in zip(result["patch_mask"][1:], truth["patch_mask"][1:], strict=True):
        assert true.sum() > 100
        assert (found & true).sum() / (found | true).sum() > 0.45


def test_columns_agree_with_the_nodal_fields(result):
    """Force and centre recomputed from the arrays of the file alone."""
    nodes, triangles = result["nodes_m"], result["triangles"]
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    facet = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    areas = np.zeros(len(nodes))
    np.add.at(areas, triangles.ravel(), np.repeat(facet / 3.0, 3))
    pressure = result["contact_pressure_pa"]
    assert np.all(pressure >= 0.0)
    assert not result["displacement_m"][:, result["rim"]].any()
    force = -(pressure * areas) @ result["normals"]
    np.testing.assert_allclose(result["force_n"], force, atol=1e-9)
    load = pressure[2] * areas
    moved = nodes + result["displacement_m"][2][:, None] * result["normals"]
    np.testing.assert_allclose(result["center_of_pressure_m"][2], load @ moved / load.sum())


def test_json_times_exclude_the_first_frame(folder, result):
    told = json.loads((folder / "told.json").read_text())
    assert told["frames"] == len(HEIGHTS)
    assert told["status"] == {"no_contact": 1, "ok": 3}
    warm = result["total_ms"][1:]
    assert told["median_total_ms"] == pytest.approx(np.median(warm))
    assert told["p95_total_ms"] == pytest.approx(np.percentile(warm, 95))
    assert told["median_solve_ms"] == pytest.approx(np.median(result["solve_ms"][1:]))
    assert told["max_force_n"] == pytest.approx(np.linalg.norm(result["force_n"], axis=1).max())
    assert np.all(result["solve_ms"] <= result["total_ms"])


def copied(source, path, change):
    """Copy of a recording in which frames in `change` have a constant depth (NaN: no returns)."""
    with Recording(source) as old, RecordingWriter(path) as new:
        for k in range(len(old)):
            frame = old[k]
            if k in change:
                frame = replace(frame, depth_m=np.full_like(frame.depth_m, change[k]))
            new.write(frame)
    return path


def test_a_frame_without_data_in_the_middle(folder, tmp_path, result):
    recording = copied(folder / "rec.mcap", tmp_path / "hole.mcap", {2: np.nan})
    out = tmp_path / "r.npz"
    told = facts_of("estimate", recording, "--sensor", PRESET, "--out", out)
    assert told["status"] == {"no_contact": 1, "ok": 2, "no_data": 1}
    assert told["failure"].startswith("no_data: too few depth pixels")
    assert told["rms_force_n"] > 0.0
    found = arrays(out)
    assert found["status"].tolist() == ["no_contact", "ok", "no_data", "ok"]
    numbers = ("displacement_m", "contact_pressure_pa", "gas_pressure_change_pa", "force_n")
    derived = ("center_of_pressure_m", "patch_area_m2", "residual_rms_m", "kkt_residual",
               "force_sigma_n", "wrench_covariance")  # fmt: skip
    for key in (*numbers, *derived):
        assert np.isnan(found[key][2]).all(), key
        assert np.isfinite(found[key][3]).all(), key
    assert not found["patch_mask"][2].any()
    np.testing.assert_allclose(found["force_n"][3], result["force_n"][3], rtol=0.02, atol=0.05)


def test_camera_info_of_the_recording_has_priority(folder, tmp_path, result):
    sensor = load_sensor(PRESET)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(sensor_to_toml(changed(sensor, camera={"fx": 1.2 * sensor.camera.fx})))
    output_of("estimate", folder / "rec.mcap", "--sensor", wrong, "--out", tmp_path / "r.npz")
    np.testing.assert_allclose(arrays(tmp_path / "r.npz")["force_n"], result["force_n"])


# -- the file, without a solver -----------------------------------------------------------------


@pytest.fixture(scope="module")
def small():
    sensor = load_sensor(PRESET)
    return changed(sensor, membrane={"nodes": 60})


def fake_results(frames, nodes, shape):
    for k in range(frames):
        mask = np.zeros(shape, bool)
        mask[k % shape[0]] = True
        estimate = Estimate("ok", np.full(nodes, -1e-3 * k), np.full(nodes, 2.0 * k), 1.0, 0.0, 0.0)
        patch = Patch(5.0, np.ones(nodes, bool), np.ones(3), np.zeros(3), 1e-4, pixel_mask=mask)
        yield Result(Frame(k, k / 30.0, np.ones(shape)), estimate, patch, times_ms={"total": 1.0})


def test_masks_of_a_long_recording_are_streamed(small, tmp_path):
    """61 MB of masks with little memory, and every one where it belongs."""
    mesh, frames, shape, path = build_mesh(small), 200, (480, 640), tmp_path / "r.npz"
    table = FrameTable("small")
    tracemalloc.start()
    try:
        with ResultWriter(path, mesh, frames, shape) as writer:
            for result in fake_results(frames, len(mesh.nodes), shape):
                writer.add(result)
                table.add(result)
            writer.finish(table.rows(), version="1")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 10e6
    assert path.stat().st_size < 5e6
    with np.load(path) as file:
        masks, displacement = file["patch_mask"], file["displacement_m"]
    assert masks.shape == (frames, *shape)
    rows = np.arange(frames)
    assert masks[rows, rows % shape[0]].all()
    assert masks.sum() == frames * shape[1]
    np.testing.assert_array_equal(displacement[:, 5], -1e-3 * rows)


# -- the real recording -------------------------------------------------------------------------

DENT_MESH_AXES_MM = np.array([24.7, 7.8])
"""Where the poker is, in the mesh axes of the recording's README."""

MESH_AXES_R = np.array([[0.9063, 0.0, -0.4226], [0.0, 1.0, 0.0], [0.4226, 0.0, 0.9063]])
"""p_mesh = p_cam @ R."""


EVERY = 1 if "TEST_ALL" in os.environ else 6
"""Every which frame of the real press."""


@pytest.fixture(scope="module")
def press(punyo_press, tmp_path_factory):
    out = tmp_path_factory.mktemp("punyo") / "result.npz"
    words = ["--sensor", "punyo_oval_d405", "--frames", f"0:90:{EVERY}"]
    output_of("estimate", punyo_press, *words, "--out", out)
    return arrays(out)


def test_real_contact_free_frames_have_no_patch_and_no_force(press):
    free = press["frame"] < 60
    assert free.sum() == 60 // EVERY
    force = np.linalg.norm(press["force_n"][free], axis=1)
    assert np.sqrt(np.mean(force**2)) <= 0.05
    assert not press["patch_mask"][free].any()
    assert not press["patch_area_m2"][free].any()


def test_real_press_is_found_at_the_poker(press):
    held = press["frame"] >= 72
    assert held.sum() == 18 // EVERY
    assert set(press["status"][held]) == {"ok"}
    T = load_sensor("punyo_oval_d405").camera.T_B_C
    np.testing.assert_allclose(T[:3, :3], MESH_AXES_R.T, atol=1e-3)  # B is parallel to them
    dent = 1e-3 * DENT_MESH_AXES_MM + T[:2, 3]  # whose origin is the camera
    miss = np.linalg.norm(press["center_of_pressure_m"][held][:, :2] - dent, axis=1)
    assert np.all(miss <= 3e-3), f"up to {1e3 * miss.max():.1f} mm off"
    assert press["patch_mask"][held].any(axis=(1, 2)).all()
