"""Foreign files: damage gives one sentence, and unpacking has a limit."""

import io
import zipfile

import numpy as np
import pytest

from bubbleviz.camera import PixelModel
from bubbleviz.errors import InputError
from bubbleviz.files import as_input_error, read_npy, read_npz, read_toml, read_triangles
from bubbleviz.recordings import ImageFolder, read_intrinsics
from bubbleviz.sensor import load_sensor


def npy(array, shape=None):
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=True)
    data = buffer.getvalue()
    return data.replace(b"(2, 3), ", shape) if shape else data


@pytest.mark.parametrize(
    "data",
    [
        npy(np.ones((2, 3)), b"(1000000, 1000000), "),
        npy(np.ones((2, 3)), b"(-2, 3), "),
        npy(np.array([None])),
        npy(np.zeros(2, [("a", "f8")])),
        npy(np.ones((2, 3)))[:-8],
        b"\x93NUMPY\x03\x00" + bytes(100),
        b"",
    ],
)
def test_missing_array_is_refused(data, tmp_path):
    with (
        pytest.raises(InputError, match="x: the array cannot be read"),
        as_input_error("x", "the array"),
    ):
        read_npy(io.BytesIO(data), len(data))


def test_decompression_bomb_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("bubbleviz.files.reading.MAX_ARRAY_BYTES", 1 << 20)
    np.savez_compressed(tmp_path / "bomb.npz", mask=np.zeros(2 << 20, np.uint8))
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("unpacked"))
    with pytest.raises(ValueError, match="larger than 1 MiB"):
        read_npz(tmp_path / "bomb.npz")


@pytest.mark.parametrize(
    ("read", "name", "text"),
    [
        (read_toml, "a.toml", f"a = {'[' * 5000}"),
        (read_toml, "a.toml", f"a = {'9' * 6000}"),
        (read_intrinsics, "a.json", "[" * 100_000),
        (read_intrinsics, "a.json", '{"width": ' + "9" * 6000 + "}"),
        (read_triangles, "a.obj", "v x y\nf 1 1 1\n"),
        (read_triangles, "a.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n"),
        (read_triangles, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        (read_triangles, "a.stl", "solid a\nvertex 0 0 0\nvertex 1 0 0\n"),
        (read_triangles, "a.stl", "not an STL file"),
    ],
)
def test_text_that_breaks_parsers_gives_one_sentence(tmp_path, capfd, read, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=f"{name}: .* cannot be read") as caught:
        read(tmp_path / name)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("read", [load_sensor, read_triangles])
def test_too_long_file_name_gives_one_sentence(read):
    with pytest.raises(InputError, match="no such"):
        read("x" * 300 + ".stl")


def test_a_mesh_whose_triangles_share_a_centre_is_read(tmp_path):
    """10,000 of them, as a fan has: all pairs of its 10,000 equal vertices took gigabytes."""
    angle = np.linspace(0.0, 2.0 * np.pi, 10_001)
    rim = 0.01 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    facets = np.zeros(10_000, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facets["v"][:, 1], facets["v"][:, 2] = rim[:-1], rim[1:]
    path = tmp_path / "fan.stl"
    path.write_bytes(bytes(80) + np.uint32(10_000).tobytes() + facets.tobytes())
    vertices, triangles = read_triangles(path)
    assert (len(vertices), len(triangles)) == (10_001, 10_000)


def test_mesh_of_nearly_coincident_vertices_is_refused(tmp_path):
    near = 1e-12 * np.arange(6000).reshape(-1, 3)
    lines = [f"v {x} {y} {z}" for x, y, z in [*near, (1, 0, 0)]] + ["f 1 2 2001"]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    with pytest.raises(InputError, match="nearly"):
        read_triangles(tmp_path / "a.obj")


def test_an_obj_of_polygons_and_negative_numbers(tmp_path):
    """A square and a triangle, the latter by the vertices that came last."""
    text = "v 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\nf -4 -3 -2\n"
    (tmp_path / "a.obj").write_text(text)
    vertices, triangles = read_triangles(tmp_path / "a.obj")
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])


@pytest.mark.parametrize(
    "data",
    [
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 32 24\n%%EndComments\nshowpage\n",
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0N \0\0N \x10\0\0\0\0" + bytes(40),
    ],
    ids=["EPS", "400 Mpx"],
)
def test_picture_that_is_not_a_depth_image_is_refused(tmp_path, data, monkeypatch):
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: pytest.fail("ran a program"))
    (tmp_path / "1.png").write_bytes(data)
    with pytest.raises(InputError, match=r"1\.png: the image cannot be read"):
        ImageFolder(tmp_path, rate_hz=30.0)


@pytest.mark.parametrize("value", [1e30, 1e-30, -1.0, np.nan, np.zeros((0, 0), ">f4")])
@pytest.mark.parametrize("kind", [">f4", "<f8"])
def test_an_array_without_depths_warns_of_nothing(tmp_path, value, kind, recwarn):
    array = np.full((24, 32), value, kind) if np.ndim(value) == 0 else value
    np.save(tmp_path / "1.npy", array)
    try:
        folder = ImageFolder(tmp_path, rate_hz=30.0)
        assert not np.isfinite(folder[0].depth_m).any()
    except InputError as error:
        assert "1.npy" in str(error)
    assert not recwarn.list


@pytest.mark.parametrize(
    "changes",
    [
        {"correlated_pixels": np.ones(2)},
        {"correlated_pixels": np.array(np.nan)},
        {"noise_m": np.zeros((4, 5))},
        {"bias_m": np.full((4, 5), 1e30)},
        {"mask": np.array(["a"] * 20).reshape(4, 5)},
    ],
)
def test_pixel_counts_of_no_camera_are_refused(tmp_path, changes):
    path, shape = tmp_path / "pixels.npz", (4, 5)
    good = {"mask": np.ones(shape, bool), "bias_m": np.zeros(shape)}
    good |= {"noise_m": np.full(shape, 1e-3), "correlated_pixels": np.array(2.0)}
    np.savez(path, **good)
    assert PixelModel.load(path, shape).correlated_pixels == 2.0
    np.savez(path, **{**good, **changes})
    with pytest.raises(InputError, match=r"pixels\.npz: .*identify the sensor again"):
        PixelModel.load(path, shape)
