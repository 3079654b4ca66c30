"""The command export: files read back by other programs' readers, against RESULT.npz."""

import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
import pyvista
from PIL import Image

import bubbleviz as bv
from bubbleviz.progress import Cancelled
from bubbleviz.recordings import Recording, RecordingWriter
from tests.program import MAIN, output_of, python, rows_of, run

SERIES = "vtk,ply,patch,png"
ALL = f"table,parquet,plots,{SERIES}"
PRESSED = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory, press, sensor):
    """Everything at once."""
    out = tmp_path_factory.mktemp("out") / "all.of it"
    output_of("export", press, "--sensor", sensor, "--out", out, "--what", ALL)
    return out


def columns_of(rows, *names):
    return np.array([[float(row[name]) for name in names] for row in rows])


# -- tables ------------------------------------------------------------------------------------


def test_csv_has_the_numbers_of_the_estimate(folder, estimated, sensor):
    rows = rows_of(folder / "all.of it.csv")
    assert [row["status"] for row in rows] == estimated["status"].tolist()
    assert "ok" in estimated["status"].tolist()
    xyz = ("force_x_n", "force_y_n", "force_z_n")
    np.testing.assert_array_equal(columns_of(rows, *xyz), estimated["force_n"])
    for name in ("frame", "time_s", "patch_area_m2", "residual_rms_m", "kkt_residual"):
        np.testing.assert_array_equal(columns_of(rows, name)[:, 0], estimated[name])
    size = np.linalg.norm(estimated["force_n"], axis=1)
    np.testing.assert_allclose(columns_of(rows, "force_magnitude_n")[:, 0], size)
    assert columns_of(rows, "iterations")[PRESSED, 0] > 0
    name = bv.load_sensor(sensor).name
    assert {(row["kappa"], row["sensor"]) for row in rows} == {("", name)}  # κ: automatic


def test_measured_force_is_exported_with_the_estimate(tmp_path, press, sensor):
    """A wrench in other axes, with a bias, as a robot has it."""
    recording, bias = tmp_path / "wrench.mcap", np.array([-0.4, -0.6, -0.5, 0, 0, 0])
    pushes = [0.0, 5.0, 6.0, 6.0, 0.0]
    with Recording(press) as source, RecordingWriter(recording) as writer:
        for k, push in enumerate(pushes):
            wrench = bias + push * np.array([0.6, 0, 0.8, 0, 0, 0])
            writer.write(replace(source[k], wrench=wrench))
    exported, archive, table = (tmp_path / name for name in ("table.csv", "r.npz", "r.csv"))
    output_of("export", recording, "--sensor", sensor, "--out", exported)
    run = bv.estimate(bv.open(recording), sensor, out=archive, csv=table)
    assert "6 N median in contact by the wrench" in run.to_text()
    for path in (exported, table):
        measured = columns_of(rows_of(path), "measured_force_n")[:, 0]
        np.testing.assert_allclose(measured, pushes, atol=1e-9)
    with np.load(archive) as result:
        np.testing.assert_allclose(result["measured_force_n"], pushes, atol=1e-9)
    # that of a frame does not depend on the others that are solved
    part = bv.estimate(bv.open(recording)[1:3], sensor)
    for one in (part, bv.load_run(archive)[1:3]):
        np.testing.assert_allclose(one.columns()["measured_force_n"], pushes[1:3], atol=1e-9)


def test_parquet_has_the_columns_of_the_csv(folder):
    table = pyarrow.parquet.read_table(folder / "all.of it.parquet")
    rows = rows_of(folder / "all.of it.csv")
    assert table.column_names == list(rows[0])
    assert [str(table.schema.field(name).type) for name in ("frame", "status", "kappa")] == [
        "int64",
        "string",
        "double",
    ]
    for name in table.column_names:
        told = table.column(name).to_pylist()
        assert ["" if v is None else str(v) for v in told] == [row[name] for row in rows]


def test_a_range_of_frames_and_a_name_with_a_suffix(tmp_path, press, sensor):
    out = tmp_path / "my numbers.csv"
    words = ("--sensor", sensor, "--out", out, "--frames", "1:4:2", "--kappa", "2.5", "--json")
    assert json.loads(output_of("export", press, *words))["frames"] == 2
    assert [(row["frame"], row["kappa"]) for row in rows_of(out)] == [("1", "2.5"), ("3", "2.5")]


def test_poses_are_joined_by_frame(tmp_path, press, sensor):
    poses = tmp_path / "poses.csv"
    poses.write_text(
        "frame,time_s,status,x_m,y_m,z_m,qx,qy,qz,qw,fitness,rmse_m,stage1_rmse_m,total_ms\n"
        "2,0.1,ok,0.005,0,0.042,0,0,0,1,0.9,0.0002,0.0003,20\n"
    )
    out = tmp_path / "with.csv"
    words = ("--sensor", sensor, "--out", out, "--poses", poses, "--frames", "1:3")
    output_of("export", press, *words)
    before, posed = rows_of(out)
    assert (posed["pose_status"], posed["pose_z_m"], posed["pose_qw"]) == ("ok", "0.042", "1.0")
    assert (before["pose_status"], before["pose_z_m"]) == ("", "nan")


def test_plots_leave_standard_error_empty(tmp_path, press, sensor, monkeypatch):
    """Nor does Matplotlib print, which cannot create its folder and has no font cache."""
    (tmp_path / "file").touch()
    out = tmp_path / "plots.svg"
    monkeypatch.setenv("MPLCONFIGDIR", str(tmp_path / "file" / "matplotlib"))
    python(MAIN, "export", press, "--sensor", sensor, "--out", out)
    assert ElementTree.parse(out).getroot().tag.endswith("svg")


def test_plots(folder):
    with Image.open(folder / "all.of it.png") as picture:
        assert np.asarray(picture).std() > 5.0


# -- series ------------------------------------------------------------------------------------


def test_paraview_series(folder, estimated):
    reader = pyvista.PVDReader(folder / "all.of it.pvd")
    np.testing.assert_array_equal(reader.time_values, estimated["time_s"])
    for k in range(len(estimated["frame"])):
        reader.set_active_time_point(k)
        mesh: Any = reader.read()[0]
        u = estimated["displacement_m"][k]
        np.testing.assert_array_equal(mesh.point_data["displacement_m"], u)
        moved = estimated["nodes_m"] + u[:, None] * estimated["normals"]
        np.testing.assert_allclose(mesh.points, moved, atol=1e-12)
        vector = mesh.point_data["displacement_vector_m"]
        np.testing.assert_allclose(mesh.points - vector, estimated["nodes_m"], atol=1e-12)
        pressure = mesh.point_data["contact_pressure_pa"]
        np.testing.assert_array_equal(pressure, estimated["contact_pressure_pa"][k])
        np.testing.assert_array_equal(mesh.point_data["patch"], estimated["patch_level"][k] > 0.0)
        np.testing.assert_array_equal(mesh.regular_faces, estimated["triangles"])
        assert mesh.field_data["TimeValue"][0] == estimated["time_s"][k]


def test_ply_of_the_membrane(folder, estimated):
    import open3d

    path = folder / f"all.of it_membrane_{PRESSED:06d}.ply"
    mesh = open3d.t.io.read_triangle_mesh(str(path))
    u = estimated["displacement_m"][PRESSED]
    moved = estimated["nodes_m"] + u[:, None] * estimated["normals"]
    np.testing.assert_allclose(mesh.vertex.positions.numpy(), moved, atol=1e-7)
    np.testing.assert_array_equal(mesh.triangle.indices.numpy(), estimated["triangles"])
    body = path.read_bytes().split(b"end_header\n")[1]  # Open3D leaves other values out
    vertices = np.frombuffer(body, "<f8", 5 * len(u)).reshape(-1, 5)
    pressure = estimated["contact_pressure_pa"][PRESSED]
    np.testing.assert_array_equal(vertices[:, 3:], np.stack([u, pressure], axis=1))


def test_patch_clouds_are_the_measured_points_in_the_patch(folder, press, estimated):
    import open3d

    cloud = open3d.t.io.read_point_cloud(str(folder / f"all.of it_patch_{PRESSED:06d}.ply"))
    points = cloud.point.positions.numpy()
    with Recording(press) as recording:
        valid = np.isfinite(recording[PRESSED].depth_m)
    assert len(points) == (estimated["patch_mask"][PRESSED] & valid).sum() > 10
    assert np.abs(points[:, 2] - 0.042).max() < 2e-3  # on the cylinder's flat end
    assert np.hypot(points[:, 0] - 0.005, points[:, 1]).max() < 0.03
    pressure = cloud.point.contact_pressure_pa.numpy().ravel()
    highest = estimated["contact_pressure_pa"][PRESSED].max()
    assert 0.0 < pressure.max() <= highest
    assert np.median(pressure) > 1000.0  # about the gas pressure, 2.6 kPa
    nothing = (folder / "all.of it_patch_000000.ply").read_bytes()
    assert b"element vertex 0\n" in nothing


def test_pictures(folder, press, estimated):
    depth = np.asarray(Image.open(folder / f"all.of it_depth_{PRESSED:06d}.png"))
    pressure = np.asarray(Image.open(folder / f"all.of it_pressure_{PRESSED:06d}.png"))
    assert depth.shape == pressure.shape == (43, 56, 3)
    patch = estimated["patch_mask"][PRESSED]
    bright = pressure.astype(int).sum(axis=2)
    assert bright[patch].mean() > bright[~patch].mean() + 50.0
    said = json.loads((folder / "all.of it_pressure.json").read_text())
    assert said["quantity"] == "contact_pressure_pa"
    assert said["darkest"] == 0.0
    with Recording(press) as recording:
        frame = recording[PRESSED].depth_m
    said = json.loads((folder / "all.of it_depth.json").read_text())
    assert said["darkest"] < np.nanmedian(frame) < said["brightest"]


def test_every_frame_has_its_files(folder):
    for kind in ("", "_membrane", "_patch", "_depth", "_pressure"):
        numbers = [path.stem[-6:] for path in sorted(folder.glob(f"all.of it{kind}_[0-9]*.*"))]
        assert numbers == [f"{k:06d}" for k in range(5)]


# -- what is not needed does not run -----------------------------------------------------------


@pytest.mark.parametrize(
    ("what", "stages"),
    [
        ("depth", set()),
        ("ply", {"estimate"}),
        ("pressure", {"estimate"}),
        ("vtk", {"estimate", "fine_contact", "patch"}),
        ("patch", {"estimate", "fine_contact", "patch", "pixel_mask", "cloud"}),
        ("depth,table", {"estimate", "fine_contact", "patch"}),
    ],
)
def test_only_required_stages_run(what, stages, tmp_path, press, sensor):
    words = ["--out", tmp_path / "x", "--what", what, "--frames", "2:4", "--json"]
    ran = json.loads(output_of("export", press, "--sensor", sensor, *words))["stages"]
    assert set(ran) - {"total"} == stages
    assert set(ran.values()) == {2}


# -- whole or not at all -----------------------------------------------------------------------


def test_cancelled_export_leaves_no_files(tmp_path, press, sensor):
    def stop(step, done):
        if done > 0.5:
            assert list(tmp_path.iterdir())  # there was something to leave
            raise Cancelled

    with pytest.raises(Cancelled):
        bv.export(bv.open(press), tmp_path / "x", sensor, what="vtk,table", progress=stop)
    assert not list(tmp_path.iterdir())


def test_every_command_reports_a_truncated_recording(press, sensor, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(press.read_bytes()[:-40])
    given = (cut, "--sensor", sensor, "--frames", "2:3", "--json")
    for words in (
        ("export", *given, "--what", "depth", "--out", tmp_path / "pictures"),
        ("estimate", *given, "--out", tmp_path / "result.npz"),
        ("pose", *given, "--object", "cylinder", "--out", tmp_path / "poses.csv"),
    ):
        done = run(*words)
        assert done.exit_code == 0, done.output
        told = json.loads(done.stdout)["warning"]
        assert "cut.mcap ends early" in told
        assert f"bubbleviz: warning: {told}\n" in done.stderr
