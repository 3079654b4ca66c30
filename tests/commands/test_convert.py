"""Image folders and foreign bags become recordings with the same content."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import bubbleviz as bv
from bubbleviz.camera import DepthCamera, Intrinsics
from bubbleviz.recordings import Recording
from tests.colour.colour_bag import add_colour, add_compressed, add_pose, encoded, picture
from tests.program import facts_of, output_of, refusal
from tests.recordings.bagmaker import PERIOD, START, BagMaker, fill
from tests.recordings.realsense_bag import CLOCK_MS, PERIOD_MS, depth_units, write_realsense_bag

CAMERA = {"width": 32, "height": 24, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5}


def depths(count=3):
    rng = np.random.default_rng(0)
    images = [np.rint(rng.uniform(80.0, 120.0, (24, 32))) * 1e-3 for _ in range(count)]
    images[1][3, 4] = 0.0
    return images


def folder_of(path, kind, names):
    path.mkdir()
    for name, depth in zip(names, depths(len(names)), strict=True):
        file = path / f"{name}{kind}"
        if kind == ".npy":
            np.save(file, depth)
        elif kind == ".png":
            Image.fromarray(np.rint(1e3 * depth).astype(np.uint16)).save(file)
        else:
            Image.fromarray(depth.astype(np.float32)).save(file)
    return path


@pytest.mark.parametrize("kind", [".npy", ".png", ".tif"])
def test_folder_of_images_with_other_measurements(kind, tmp_path):
    images = folder_of(tmp_path / "images", kind, ["d1", "d2", "d10"])
    (images / "intrinsics.json").write_text(json.dumps(CAMERA))
    (tmp_path / "gas.csv").write_text("time_s,pa\n0,100000\n0.1,101000\n")
    (tmp_path / "wrench.csv").write_text("0,1,2,3,4,5,6\n0.2,3,2,3,4,5,6\n")
    out = tmp_path / "out.mcap"
    beside = ("--pressure", tmp_path / "gas.csv", "--wrench", tmp_path / "wrench.csv")
    output_of("convert", images, out, "--rate", 10, *beside)
    with Recording(out) as recording:
        assert recording.times_s == pytest.approx([0.0, 0.1, 0.2], abs=1e-6)
        assert recording.intrinsics.fy == CAMERA["fy"]
        for frame, depth in zip(recording, depths(), strict=False):
            expected = np.where(depth > 0.0, depth, np.nan)
            np.testing.assert_allclose(frame.depth_m, expected, rtol=1e-6)
        assert recording[1].gas_pressure_pa == pytest.approx(101_000.0, abs=1.0)
        assert recording[1].wrench == pytest.approx([2, 2, 3, 4, 5, 6], abs=1e-3)


@pytest.mark.parametrize("ordered", [True, False])
def test_a_folder_of_points(ordered, tmp_path):
    """(H, W, 3), or (n, 3) in any order, in the camera's optical frame."""
    images, rng = tmp_path / "images", np.random.default_rng(1)
    images.mkdir()
    (images / "intrinsics.json").write_text(json.dumps(CAMERA))
    v, u = np.mgrid[:24, :32]
    for number, depth in enumerate(depths()):
        x, y = (u - CAMERA["cx"]) / CAMERA["fx"] * depth, (v - CAMERA["cy"]) / CAMERA["fy"] * depth
        points = np.dstack([x, y, depth])
        if not ordered:
            points = rng.permutation(points[depth > 0.0])
        np.save(images / f"{number}.npy", points)
    out = tmp_path / "out.mcap"
    output_of("convert", images, out, "--rate", 10)
    with Recording(out) as recording:
        for frame, depth in zip(recording, depths(), strict=True):
            expected = np.where(depth > 0.0, depth, np.nan)
            np.testing.assert_allclose(frame.depth_m, expected, rtol=1e-6)


def test_file_names_that_are_times(tmp_path):
    names = [f"depth_{1_700_000_000_000_000_000 + k * 33_000_000}" for k in range(3)]
    out = tmp_path / "out.mcap"
    output_of("convert", folder_of(tmp_path / "images", ".png", names), out)
    with Recording(out) as recording:
        assert recording.times_s == pytest.approx([0.0, 0.033, 0.066], abs=1e-6)


@pytest.mark.parametrize("kind", ["db3 folder", "bag lz4"])
def test_other_bag_formats_give_the_same_recording(kind, tmp_path):
    path = fill(BagMaker(kind)).write(tmp_path)
    out = tmp_path / "out.mcap"
    found = facts_of("convert", path, out)
    assert found["path"] == str(out) and found["frames"] == 6
    assert found["gas_pressure_pa"] and found["wrench"]
    with Recording(path) as before, Recording(out) as after:
        assert after.times_s == pytest.approx(before.times_s)
        for a, b in zip(before, after, strict=False):
            np.testing.assert_array_equal(a.depth_m, b.depth_m)
            assert a.gas_pressure_pa == pytest.approx(b.gas_pressure_pa)
            assert a.intrinsics == b.intrinsics
            assert a.wrench == pytest.approx(b.wrench)


@pytest.mark.parametrize(
    ("unit_m", "option"),
    [(1e-4, "Depth_Units"), (1e-3, "Depth_Units"), (2.5e-5, "Depth Units"), (None, "")],
)
def test_a_bag_of_the_realsense_viewer(unit_m, option, tmp_path):
    """In any depth unit; infrared images of 16 bits are not taken for depth."""
    out = tmp_path / "out.mcap"
    write_realsense_bag(tmp_path / "camera.bag", unit_m, option)
    told = output_of("convert", tmp_path / "camera.bag", out)
    assert "4 in 0.1" in told and "32 × 24 pixels" in told and "fx 30.00" in told
    with Recording(out) as recording:
        assert recording.times_s == pytest.approx(1e-3 * PERIOD_MS * np.arange(4), abs=1e-6)
        assert recording.stamps_ns[0] == round(1e6 * CLOCK_MS)
        for k, frame in enumerate(recording):
            units = depth_units(k)
            expected = np.where(units > 0, (unit_m or 1e-3) * units, np.nan)
            np.testing.assert_allclose(frame.depth_m, expected, rtol=1e-6)
        lens = (30.0, 31.0, 15.25, 11.75, "plumb_bob", (0.1, 0.0, 0.0, 0.0, 0.01))
        assert recording.intrinsics == Intrinsics(32, 24, *lens)


@pytest.mark.parametrize(("kind", "placed"), [("jpeg", True), ("rgb8", True), ("rgb8", False)])
def test_colour_is_copied_unchanged(kind, placed, tmp_path):
    """The same bytes, camera and moments; every second frame has an image.

    A pose that was not recorded is assumed in the copy, too.
    """
    bag = fill(BagMaker("bag lz4"))
    turned = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_quat()
    if placed:
        add_pose(bag, "camera", "colour", (0.01, 0.02, 0.03), tuple(turned))
    for k in range(0, 6, 2):
        stamp = START + k * PERIOD + 7_000_000
        header = bag.header(stamp)
        header.frame_id = "colour"
        if kind == "jpeg":
            data = encoded(picture(k), "jpeg")
            add_compressed(bag, stamp, data, "rgb8; jpeg compressed bgr8", header=header)
        else:
            add_colour(bag, stamp, k, header=header)
    path, out = bag.write(tmp_path), tmp_path / "out.mcap"
    output_of("convert", path, out)
    with Recording(path) as before, Recording(out) as after:
        for k in range(6):
            old, new = before[k].colour, after[k].colour
            assert (old is None) == (new is None) == bool(k % 2)
            if old is None or new is None:
                continue
            assert new.read() == old.read()
            assert new.stamp_ns == old.stamp_ns
            assert new.camera.intrinsics == old.camera.intrinsics
            assert new.camera.remark == old.camera.remark
            np.testing.assert_allclose(new.camera.T_D_C, old.camera.T_D_C, atol=1e-12)
        camera = before[0].colour.camera
        assert camera.T_D_C[2, 3] == pytest.approx(0.03 if placed else 0.0)
        assert ("assuming the depth camera's pose" in camera.remark) is not placed


@pytest.mark.parametrize("told", [True, False])
def test_colour_images_in_a_folder_are_matched_by_number(told, tmp_path):
    """Copied byte for byte; the second depth image has none. Missing camera data are reported."""
    images = folder_of(tmp_path / "images", ".png", ["d1", "d2", "d10"])
    (images / "rgb").mkdir()
    files = {1: encoded(picture(1), "jpeg"), 10: encoded(picture(3), "png")}
    (images / "rgb" / "c_01.jpg").write_bytes(files[1])
    (images / "rgb" / "c_10.png").write_bytes(files[10])
    (images / "intrinsics.json").write_text(json.dumps(CAMERA))
    if told:
        (images / "rgb" / "intrinsics.json").write_text(json.dumps({**CAMERA, "fx": 45.0}))
    out = tmp_path / "out.mcap"
    output_of("convert", images, out, "--rate", 30)
    with Recording(out) as recording:
        camera, found = recording.colour.camera, [frame.colour for frame in recording]
    assert found[1] is None and camera.intrinsics is not None
    with Recording(out) as recording:
        read = [recording[k].colour.read() for k in (0, 2)]
    assert [(each.encoding, each.data) for each in read] == [("jpeg", files[1]), ("png", files[10])]
    assert camera.intrinsics.fx == (45.0 if told else 30.0)
    assert ("using the depth camera's" in camera.remark) is not told
    assert "assuming the depth camera's pose" in camera.remark


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (["c_7.png"], "no JPEG or PNG has the same last number in its name as a depth image"),
        (["c_1.png", "d_01.jpg"], "has the same number as c_1.png; remove or renumber"),
    ],
)
def test_colour_images_that_do_not_fit_are_refused(names, says, tmp_path):
    images = folder_of(tmp_path / "images", ".png", ["d1", "d2", "d10"])
    (images / "color").mkdir()
    for name in names:
        (images / "color" / name).write_bytes(encoded(picture(1), "png"))
    assert says in refusal("convert", images, tmp_path / "out.mcap", "--rate", 30)
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize("by_file", [False, True])
def test_intrinsics_of_a_preset_or_a_sensor_file(by_file, tmp_path):
    given = bv.load_sensor("pico_flexx_75mm")
    bv.save_sensor(given, tmp_path / "own.toml")
    (tmp_path / "images").mkdir()
    np.save(tmp_path / "images" / "1.npy", np.full((171, 224), 0.15))
    own = tmp_path / "own.toml" if by_file else "pico_flexx_75mm"
    words = ("convert", tmp_path / "images", tmp_path / "out.mcap", "--rate", 30)
    output_of(*words, "--intrinsics", own)
    with Recording(tmp_path / "out.mcap") as recording:
        assert recording.intrinsics == DepthCamera.of(given.camera).intrinsics


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda p: None, "not times in s or ns; give the rate"),
        (lambda p: (p / "9.png").write_bytes(b"\x89PNG broken"), "the image cannot be read"),
        (lambda p: np.save(p / "9.npy", np.ones((4, 5))), "5×4 pixels, the first image has 32×24"),
        (
            lambda p: np.save(p / "0.npy", np.full((24, 32), 90.0)),
            "correct the unit (--metres-per-unit)",
        ),
        (lambda p: np.save(p / "0.npy", np.full((24, 32), -0.1)), "most depths are negative"),
        (lambda p: np.save(p / "9.npy", np.ones((9, 3))), "need the camera's intrinsics"),
        (lambda p: (p / "intrinsics.toml").write_text("width = 9"), "height: missing; add it"),
        (lambda p: (p / "times.csv").write_text("0\n1\n1\n"), "3.npy: its time is not after"),
    ],
)
def test_invalid_input_gives_one_sentence(spoil, words, tmp_path):
    images = folder_of(tmp_path / "images", ".npy", ["1", "2", "3"])
    spoil(images)
    rate = () if "time" in words else ("--rate", 30)
    assert words in refusal("convert", images, tmp_path / "out.mcap", *rate)
    assert not (tmp_path / "out.mcap").exists()
    assert not list(tmp_path.glob(".out*"))


def test_measurements_by_another_clock_are_refused(tmp_path):
    """Images counted from 0, gas pressure in seconds since 1970."""
    images = folder_of(tmp_path / "images", ".npy", ["1", "2", "3"])
    (tmp_path / "gas.csv").write_text("1700000000,100000\n1700000001,100100\n")
    beside = ("--rate", 30, "--pressure", tmp_path / "gas.csv")
    told = refusal("convert", images, tmp_path / "out.mcap", *beside)
    assert "none of the gas pressures has the time of an image" in told
