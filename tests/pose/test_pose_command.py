"""The command pose: from a recording to POSES.csv, checked against the simulation."""

import csv
import json
import re

import numpy as np
import pytest
import trimesh

from bubbleviz.files import read_path
from bubbleviz.output import pose_row, read_poses, write_poses
from bubbleviz.pipeline import Pipeline
from bubbleviz.recordings import Frame
from bubbleviz.result import Pose, Result
from bubbleviz.sensor import load_sensor, save_sensor
from tests.membrane.domes import pose as upright
from tests.program import output_of, refusal, run
from tests.small_press import changed

PRESET = "pico_flexx_75mm"
HEADER = (
    "frame,time_s,status,x_m,y_m,z_m,qx,qy,qz,qw,fitness,rmse_m,stage1_rmse_m,total_ms,"
    "cov_xx,cov_xy,cov_xz,cov_xrx,cov_xry,cov_xrz,cov_yy,cov_yz,cov_yrx,cov_yry,cov_yrz,"
    "cov_zz,cov_zrx,cov_zry,cov_zrz,cov_rxrx,cov_rxry,cov_rxrz,cov_ryry,cov_ryrz,cov_rzrz"
)
HEIGHTS = (0.060, 0.038, 0.0375, 0.037)
"""Of a frustum's tip above the rim: clear of the dome (50 mm high), then pressed in."""
OFF = re.compile(r"contact is up to (\S+) mm \(rms\) off the object, .* \((\S+) mm\)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pose")
    small = changed(load_sensor(PRESET), membrane={"nodes": 400})
    save_sensor(small, folder / "small.toml")
    lines = [f"{0.1 * k},0.004,0.002,{z},0,0,0,1" for k, z in enumerate(HEIGHTS)]
    (folder / "path.csv").write_text("\n".join(["time_s,x_m,y_m,z_m,qx,qy,qz,qw", *lines]))
    output_of(
        "simulate", "--sensor", folder / "small.toml", "--object", "frustum",
        "--path", folder / "path.csv",
        "--noise-relative", "0.005", "--out", folder / "rec.mcap", "--truth", folder / "truth.npz",
    )  # fmt: skip
    return folder


def command(folder, out, *more, obj="frustum"):
    words = ("--sensor", folder / "small.toml", "--object", obj, "--out", folder / out, *more)
    return "pose", folder / "rec.mcap", *words


@pytest.fixture(scope="module")
def tracked(folder):
    """Header and rows of the poses with areas by the object, and the summary."""
    more = ("--init", "0.006 0.001 0.037 0 0 0.05 0.99875", "--object-patch", "--json")
    done = run(*command(folder, "poses.csv", *more))
    assert done.exit_code == 0 and not OFF.search(done.stderr)
    header, *lines = (folder / "poses.csv").read_text().splitlines()
    return header, list(csv.DictReader([header, *lines])), json.loads(done.stdout)


def test_poses_equal_those_of_the_simulation(folder, tracked):
    _, rows, summary = tracked
    assert [row["status"] for row in rows] == ["no_contact", "ok", "ok", "ok"]
    with np.load(folder / "truth.npz") as truth:
        for row, T in list(zip(rows, truth["T_B_O"], strict=True))[1:]:
            # where a flat tip is determined: its height and tilt
            assert float(row["z_m"]) == pytest.approx(T[2, 3], abs=8e-4)
            assert np.hypot(float(row["qx"]), float(row["qy"])) < np.radians(2.0) / 2.0
            assert abs(float(row["x_m"]) - T[0, 3]) < 3e-3
            assert float(row["fitness"]) > 0.8
            assert float(row["total_ms"]) > 0.0
    assert summary["status"] == {"no_contact": 1, "ok": 3}
    assert summary["median_fitness"] > 0.8


def test_a_search_lists_the_other_poses_that_fit_as_well(folder, tmp_path):
    """A cuboid touches lightly; any of them can be given as the first one."""
    mesh, rows = tmp_path / "box.stl", ["time_s,x_m,y_m,z_m,qx,qy,qz,qw", "0,0,0,0.062,0,0,0,1"]
    trimesh.creation.box((0.024, 0.018, 0.030)).export(mesh)
    (tmp_path / "path.csv").write_text("\n".join(rows))
    given = "--sensor", folder / "small.toml", "--object", mesh, "--out"
    output_of("simulate", *given, tmp_path / "rec.mcap", "--path", tmp_path / "path.csv")
    command = "pose", tmp_path / "rec.mcap", *given, tmp_path / "poses.csv", "--overwrite"
    told = run(*command).stderr
    assert "in 1 frame other poses fit as well, last in frame 0" in told
    others = re.findall("'([^']+)'", told)
    assert len(others) >= 2
    for each in (others[0], others[-1]):
        done = run(*command, "--init", each)
        assert done.exit_code == 0 and "fit as well" not in done.stderr


def test_a_contact_that_is_not_on_the_object_is_told(folder):
    """That of the frustum itself is not, see `tracked`."""
    done = run(*command(folder, "nut.csv", "--frames", "2:", obj="hex_nut"))
    assert done.exit_code == 0
    found = OFF.search(done.stderr)
    assert float(found[1]) > float(found[2]) > 0.1


def test_area_of_the_object_patch_is_an_optional_column(folder, tracked):
    header, (free, *pressed), summary = tracked
    assert header == HEADER + ",patch_area_m2,object_patch_area_m2"
    assert free["status"] == "no_contact" and np.isnan(float(free["object_patch_area_m2"]))
    for row in pressed:
        assert float(row["object_patch_area_m2"]) == pytest.approx(0.025**2, rel=0.35)
        assert float(row["patch_area_m2"]) > 0.0
    median = np.median([float(row["object_patch_area_m2"]) for row in pressed])
    assert summary["median_object_patch_area_m2"] == pytest.approx(median)
    columns = read_poses(folder / "poses.csv")
    assert columns[3]["pose_object_patch_area_m2"] == float(pressed[-1]["object_patch_area_m2"])
    more = ("--init", "0.004 0.002 0.038 0 0 0 1", "--object-patch", "--frames", "2:3")
    told = output_of(*command(folder, "areas.csv", *more))
    (row,) = read_poses(folder / "areas.csv").values()
    assert f"{1e6 * row['pose_object_patch_area_m2']:.0f} mm² by the object" in told
    assert "mm (medians of 1 ok frame)\n" in told


def test_bad_input_is_one_line(folder, tmp_path):
    (folder / "there.csv").write_text("")
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 0.01 0 0\nv 0.02 0 0\nf 1 2 3\n")
    tiny = tmp_path / "tiny.stl"
    trimesh.creation.box((0.002, 0.002, 0.002)).export(tiny)
    big = tmp_path / "big.obj"
    big.write_text("v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    cases = [
        (command(folder, "there.csv"), "exists already"),
        (command(folder, "a.csv", obj=flat), "no area"),
        (command(folder, "b.csv", obj=big), "if the file is in millimetres"),
        (command(folder, "c.csv", "--init", "1 2"), "give seven numbers"),
        (command(folder, "d.csv", "--frames", "0:1"), "nothing touches the membrane"),
        (command(folder, "e.csv", obj="teapot"), "no such object"),
        # of two frames, one has contact
        (command(folder, "e.csv", "--frames", "0:2", obj=tiny), "does not fit the contact"),
    ]
    for words, said in cases:
        assert said in refusal(*words)
    assert sorted(p.name for p in folder.glob("[a-e].csv")) == []


def test_unit_of_the_mesh_file_option(folder, tmp_path):
    block = tmp_path / "block.obj"
    corners = [f"v {x} {y} {z}" for z in (0, 40) for y in (-12.5, 12.5) for x in (-12.5, 12.5)]
    faces = ["f 1 3 4 2", "f 5 6 8 7", "f 1 2 6 5", "f 3 7 8 4", "f 1 5 7 3", "f 2 4 8 6"]
    block.write_text("\n".join([*corners, *faces]))
    more = ("--init", "0.004 0.002 0.038 0 0 0 1", "--frames", "1:3")
    refusal(*command(folder, "m.csv", *more, obj=block))
    output_of(*command(folder, "mm.csv", "--unit", "mm", *more, obj=block))
    assert (folder / "mm.csv").read_text().splitlines()[0] == HEADER  # without areas


def test_covariance_of_a_line_is_the_upper_triangle_row_by_row():
    pose = Pose("ok", upright(0.02, -0.01, 0.08), covariance=np.arange(36.0).reshape(6, 6))
    frame = Frame(7, 0.25, np.zeros((2, 2), np.float32))
    row = pose_row(Result(frame, pose=pose, times_ms={"total": 5.0}))
    found = {name: value for name, value in row.items() if name.startswith("cov_")}
    assert list(found.values()) == pose.covariance[np.triu_indices(6)].tolist()
    assert found["cov_xy"] == 1.0 and found["cov_yry"] == 10.0 and found["cov_rzrz"] == 35.0


def test_tum_has_the_good_poses_only(tmp_path):
    T = upright(0.01, 0.02, 0.03)
    frame = Frame(7, 0.25, np.zeros((2, 2), np.float32))
    rows = [
        pose_row(Result(frame, pose=Pose(status, T), times_ms={"total": 5.0}))
        for status in ("ok", "lost")
    ]
    assert write_poses(tmp_path / "a.tum", rows, "tum") == 1
    numbers = np.loadtxt(tmp_path / "a.tum")
    assert np.allclose(numbers, [0.25, 0.01, 0.02, 0.03, 0.0, 0.0, 0.0, 1.0])
    assert write_poses(tmp_path / "a.csv", rows[:1], "csv") == 1
    poses, _ = read_path(tmp_path / "a.csv")
    assert np.allclose(poses[0], T)
    assert (tmp_path / "a.csv").read_text().splitlines()[0] == HEADER
    known = [
        row | {"object_patch_area_m2": area} for row, area in zip(rows, (6e-4, np.nan), strict=True)
    ]
    assert write_poses(tmp_path / "b.csv", known, "csv") == 2
    assert [row.split(",")[-1] for row in (tmp_path / "b.csv").read_text().splitlines()] == [
        "object_patch_area_m2", "0.0006", "nan"
    ]  # fmt: skip


def test_without_the_pose_product_no_row_is_written():
    with pytest.raises(ValueError, match="has no pose"):
        pose_row(Result(Frame(0, 0.0, np.zeros((2, 2), np.float32))))
    pipeline = Pipeline.of(load_sensor(PRESET))
    assert pipeline.tracker is None
