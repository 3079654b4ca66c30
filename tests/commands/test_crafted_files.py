"""Crafted and damaged files: each is read, or refused in one line, by the command alone."""

import io
import json
import os
import struct
import zipfile
import zlib

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from tests import program
from tests.commands.limited import MEMORY, in_process
from tests.recordings.bagmaker import PERIOD, START, BagMaker, depth_image

IMAGE = "sensor_msgs/msg/Image"
POSE = "0 0 0.06 0 0 0 1"


def in_one_line(code, stdout, stderr, *says):
    """Whether a command did its work, or refused it in one line."""
    assert "Traceback" not in stderr, stderr
    assert code in (0, 2), stderr
    if code:
        assert stderr.startswith("bubbleviz: ") and stderr.count("\n") == 1, stderr
        assert not stdout
        assert all(word in stderr for word in says), stderr


def run(*words, says=""):
    """A command that does its work, or refuses it in one line with these words."""
    done = program.run(*words)
    in_one_line(done.exit_code, done.stdout, done.stderr, says)
    assert done.exception is None or isinstance(done.exception, SystemExit)
    return done


def image_message(k, stamp=START, kind="mcap file"):
    """Serialised image message."""
    bag = BagMaker(kind)
    bag.image(stamp, depth_image(k))
    return bag.payload(IMAGE, bag.rows[0][3])


def write_mcap(path, payloads, times_ns, **options):
    """Depth messages by the library of the format."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30, **options)
        writer.start("ros2", "crafted")
        definition, _ = BagMaker("mcap file").store.generate_msgdef(IMAGE, ros_version=2)
        schema = writer.register_schema(IMAGE, "ros2msg", definition.encode())
        channel = writer.register_channel("/depth", "cdr", schema)
        for payload, time_ns in zip(payloads, times_ns, strict=True):
            writer.add_message(channel, time_ns, payload, time_ns)
        writer.finish()


def with_pixels(sensor, folder, **arrays):
    """Sensor file with a file of its pixels."""
    path = folder / "sensor.toml"
    path.write_text(f'{sensor.read_text()}\n[calibration]\npixels_file = "pixels.npz"\n')
    if arrays:
        np.savez(folder / "pixels.npz", **arrays)
    return path


# -- bombs ---------------------------------------------------------------------------------------


BOMBS = {
    "mcap zstd": {},
    "mcap lz4": {"compression": CompressionType.LZ4},
    "mcap without an index": {
        "index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False,
    },
}  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    [
        "mcap zstd",
        "bag lz4",
        *(
            pytest.param(each, marks=pytest.mark.long)
            for each in (*list(BOMBS)[1:], "mcap messages")
        ),
    ],
)
def test_recording_of_which_a_message_is_300_mib_of_zeros(tmp_path, kind):
    payloads, path = [image_message(k, kind=kind) for k in range(2)], tmp_path / "bomb.mcap"
    payloads[1] += bytes(300 << 20)
    if kind in BOMBS:
        write_mcap(path, payloads, (1, 2), **BOMBS[kind])
    else:
        bag = BagMaker(kind)
        bag.rows = [("/depth", IMAGE, START + k, data) for k, data in enumerate(payloads)]
        path = bag.write(tmp_path, "bomb")
    done, peak = in_process(tmp_path, "convert", path, tmp_path / "out.mcap")
    assert peak < MEMORY, f"{peak >> 20} MiB"
    in_one_line(done.returncode, done.stdout, done.stderr, path.name)
    assert done.returncode == 2


def npz_bomb(path, mib):
    """A mask of zeros; 1 MiB of them is compressed once and repeated."""
    header, pack = io.BytesIO(), zlib.compressobj(9, zlib.DEFLATED, -15)
    shape = {"descr": "|u1", "fortran_order": False, "shape": (mib, 1 << 20)}
    np.lib.format.write_array_header_1_0(header, shape)
    packed = pack.compress(header.getvalue()) + pack.flush(zlib.Z_FULL_FLUSH)
    packed += mib * (pack.compress(bytes(1 << 20)) + pack.flush(zlib.Z_FULL_FLUSH)) + pack.flush()
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("mask.npy", packed)  # stored: the headers are changed to deflated
    data, size = bytearray(path.read_bytes()), len(header.getvalue()) + (mib << 20)
    for at, method, length in ((0, 8, 22), (data.index(b"PK\1\2"), 10, 24)):
        struct.pack_into("<H", data, at + method, zipfile.ZIP_DEFLATED)
        struct.pack_into("<I", data, at + length, size)
    path.write_bytes(data)


def test_pixels_file_of_1500_mib(tmp_path, sensor, press):
    npz_bomb(tmp_path / "pixels.npz", 1500)
    assert (tmp_path / "pixels.npz").stat().st_size < 2 << 20
    words = ("--sensor", with_pixels(sensor, tmp_path), "--out", tmp_path / "r.npz")
    done, peak = in_process(tmp_path, "estimate", press, *words)
    assert peak < MEMORY, f"{peak >> 20} MiB"
    in_one_line(done.returncode, done.stdout, done.stderr, "pixels.npz")
    assert done.returncode == 2


def test_mesh_of_10000_triangles_that_share_a_vertex(tmp_path, sensor):
    angle = np.linspace(0.0, 2.0 * np.pi, 10_001)
    rim = 0.01 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    facets = np.zeros(10_000, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facets["v"][:, 1], facets["v"][:, 2] = rim[:-1], rim[1:]
    path = tmp_path / "fan.stl"
    path.write_bytes(bytes(80) + np.uint32(10_000).tobytes() + facets.tobytes())
    words = ("--sensor", sensor, "--object", path, "--pose", POSE, "--out", tmp_path / "r.mcap")
    done, peak = in_process(tmp_path, "simulate", *words)
    assert peak < MEMORY, f"{peak >> 20} MiB"
    in_one_line(done.returncode, done.stdout, done.stderr)
    assert done.returncode == 0, done.stderr


# -- files that run or read others ----------------------------------------------------------------


def test_picture_that_is_a_program_is_not_run(tmp_path, monkeypatch):
    """PostScript, for which Pillow starts Ghostscript."""
    program, folder = tmp_path / "bin" / "gs", tmp_path / "images"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ntouch {tmp_path / 'ran'}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    folder.mkdir()
    code = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 32 24\n%%EndComments\nshowpage\n"
    (folder / "1.png").write_bytes(code)
    run("convert", folder, tmp_path / "out.mcap", "--rate", "30", says="1.png")
    assert not (tmp_path / "ran").exists()


# -- files that break their readers ---------------------------------------------------------------


def images(folder, array=None, **files):
    """A folder of one depth image, or of files with the given content, and its intrinsics."""
    folder = folder / "images"
    folder.mkdir()
    camera = {"width": 32, "height": 24, "fx": 18.0, "fy": 18.0, "cx": 15.5, "cy": 11.5}
    files = {"intrinsics_json": json.dumps(camera)} | files
    for name, content in files.items():
        data = content if isinstance(content, bytes) else content.encode()
        (folder / name.replace("_", ".")).write_bytes(data)
    if array is not None:
        np.save(folder / "1.npy", array)
    return folder


def npy(shape, value=0.0):
    """An array of 24 × 32 equal values, of which the header claims a shape."""
    file = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + np.full(24 * 32, value).tobytes()


def png(width, height, rest=()):
    """A 16-bit PNG: its header, and the chunks that follow."""
    header = (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0))
    chunks = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in (header, *rest)
    ]
    return b"".join([b"\x89PNG\r\n\x1a\n", *chunks])


SOME_ROWS = zlib.compress(bytes(65 * 10))[:-8]
DEPTH = np.full((24, 32), 0.1, np.float32)
IMAGES = {
    "depths of 1e300 m after one of 0.1 m": {"array": DEPTH, "2_npy": npy((24, 32), 1e300)},
    "array of 10⁶ × 10⁶": {"1_npy": npy((10**6, 10**6))},
    "array of -2 × 3": {"1_npy": npy((-2, 3))},
    "PNG of 400 Mpx": {"1_png": png(20_000, 20_000, [(b"IDAT", b"")])},
    "PNG with a broken chunk": {"1_png": png(32, 24, [(b"IDAT", SOME_ROWS), (bytes(4), b"")])},
    "JSON nested 100,000 deep": {"array": DEPTH, "intrinsics_json": "[" * 100_000},
    "JSON number of 6,000 digits": {"array": DEPTH, "intrinsics_json": "[" + "9" * 6000 + "]"},
    "times of 1e308 s": {"array": DEPTH, "times_csv": "1e308\n"},
}  # fmt: skip


@pytest.mark.parametrize("files", IMAGES.values(), ids=IMAGES.keys())
def test_folder_of_images(tmp_path, recwarn, capfd, files):
    folder, out = images(tmp_path, **files), tmp_path / "out.mcap"
    done = run("convert", folder, out, *(() if "times_csv" in files else ("--rate", "30")))
    if done.exit_code == 0:
        run("info", out)
    assert not recwarn.list and capfd.readouterr() == ("", "")


def test_unset_stamps_and_a_log_time_of_292_years(tmp_path):
    write_mcap(tmp_path / "rec.mcap", [image_message(k, 0) for k in range(3)], (1, 2, 2**63 - 1))
    run("info", tmp_path / "rec.mcap")
    run("convert", tmp_path / "rec.mcap", tmp_path / "out.mcap")


@pytest.mark.parametrize("depth_m", [1e-30, pytest.param(1e30, marks=pytest.mark.long), 1e38])
def test_recording_of_impossible_depths(tmp_path, sensor, recwarn, depth_m):
    bag = BagMaker("mcap file")
    for k in range(3):
        bag.image(START + k * PERIOD, np.full((43, 56), depth_m, np.float32))
    path, given = bag.write(tmp_path), ("--sensor", sensor)
    run("estimate", path, *given, "--out", tmp_path / "r.npz", says="rec.mcap")
    run("export", path, *given, "--what", "depth,plots", "--out", tmp_path / "out")
    assert not recwarn.list


def test_compressed_depth_of_144_megapixels(tmp_path, recwarn):
    bag, kind = BagMaker("mcap file"), "sensor_msgs/msg/CompressedImage"
    data = struct.pack("<iff", 0, 0.0, 0.0) + png(12_000, 12_000, [(b"IDAT", b"")])
    fields = {"header": bag.header(START), "format": "16UC1; compressedDepth"}
    bag.add("/depth", kind, START, **fields, data=np.frombuffer(data, np.uint8))
    assert "12000×12000" in program.refusal("info", bag.write(tmp_path))
    assert not recwarn.list


MESHES = {
    "obj of two numbers a vertex": ("a.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n"),
    "obj of words": ("a.obj", "v x y\nf 1 1 1\n"),
    "obj of a missing vertex": ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    "stl that ends early": ("a.stl", "solid a\nvertex 0 0 0\nvertex 1 0 0\n"),
    "stl of other text": ("a.stl", "not an STL file"),
    "ply of other text": ("a.ply", "ply\nhello\n"),
}


@pytest.mark.parametrize(("name", "text"), MESHES.values(), ids=MESHES.keys())
def test_mesh_of_an_object(tmp_path, sensor, name, text):
    (tmp_path / name).write_text(text)
    words = ("--sensor", sensor, "--object", tmp_path / name, "--pose", POSE)
    assert name in program.refusal("simulate", *words, "--out", tmp_path / "r.mcap")


def test_mesh_of_unreadable_normals_is_read_silently(tmp_path, sensor, capfd, caplog):
    corners = "vertex 0 0 0\nvertex 0.01 0 0\nvertex 0 0.01 0\n"
    text = f"solid a\nfacet normal x y z\nouter loop\n{corners}endloop\nendfacet\nendsolid\n"
    (tmp_path / "a.stl").write_text(text)
    words = ("--sensor", sensor, "--object", tmp_path / "a.stl", "--pose", POSE)
    run("simulate", *words, "--out", tmp_path / "r.mcap")
    assert (capfd.readouterr(), caplog.records) == (("", ""), [])


@pytest.mark.parametrize("value", ["[" * 5000, "9" * 6000], ids=["nested", "6,000 digits"])
def test_sensor_file(tmp_path, press, value):
    (tmp_path / "a.toml").write_text(f"a = {value}")
    words = ("--sensor", tmp_path / "a.toml", "--out", tmp_path / "r.npz")
    assert "a.toml" in program.refusal("estimate", press, *words)


@pytest.mark.parametrize(
    "changes",
    [
        {"correlated_pixels": np.ones(2)},
        {"correlated_pixels": np.array(np.inf)},
        {"noise_m": np.zeros((4, 5))},
        {"bias_m": np.full((43, 56), 1e30)},
        {"mask": np.full((43, 56), "a")},
    ],
)  # fmt: skip
def test_pixels_file(tmp_path, sensor, press, recwarn, changes):
    shape = (43, 56)
    good = {"mask": np.ones(shape, bool), "bias_m": np.zeros(shape)}
    good |= {"noise_m": np.full(shape, 1e-3), "correlated_pixels": np.array(2.0)}
    words = ("--out", tmp_path / "r.npz", "--frames", "0:1")
    for arrays, code in ((good, 0), (good | changes, 2)):
        own = with_pixels(sensor, tmp_path, **arrays)
        done = run("estimate", press, "--sensor", own, *words, "--overwrite", says="pixels.npz")
        assert done.exit_code == code
    assert not recwarn.list


@pytest.mark.parametrize("time_s", ["1e308", "1e400", "9" * 400])
def test_poses_of_endless_times(tmp_path, sensor, recwarn, time_s):
    rows = "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0,0.06,0,0,0,1\n"
    (tmp_path / "poses.csv").write_text(f"{rows}{time_s},0,0,0.06,0,0,0,1\n")
    words = ("--sensor", sensor, "--object", "cylinder", "--path", tmp_path / "poses.csv")
    assert "poses.csv" in program.refusal("simulate", *words, "--out", tmp_path / "r.mcap")
    assert not recwarn.list


@pytest.mark.parametrize(
    "words",
    [
        ("estimate", "REC", "--sensor", "LONG", "--out", "r.npz"),
        ("estimate", "REC", "--sensor", "SENSOR", "--out", "LONG"),
        ("simulate", "--sensor", "SENSOR", "--object", "LONG", "--pose", POSE, "--out", "r.mcap"),
    ],
    ids=lambda words: words[words.index("LONG") - 1],
)
def test_name_of_300_bytes(tmp_path, monkeypatch, sensor, press, words):
    monkeypatch.chdir(tmp_path)
    given = {"REC": press, "SENSOR": sensor, "LONG": "x" * 300}
    assert "x" * 300 in program.refusal(*(given.get(word, word) for word in words))
