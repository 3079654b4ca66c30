"""Foreign files: damage gives one sentence, and unpacking has a limit."""

import io

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.files import as_input_error, read_npy, read_triangles
from bubbleviz.recordings import ImageFolder
from bubbleviz.sensor import edited, load_sensor, sensor_to_toml


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


def test_a_prestretch_in_per_cent_is_refused():
    sensor = load_sensor("pico_flexx_75mm")
    for within in (1.01, 10.0**0.5):  # the latter is the largest that `identify` finds
        assert edited(sensor, {"membrane.prestretch": within}).membrane.prestretch == within
    with pytest.raises(InputError, match=r"prestretch = 8\.2: it should be less than"):
        edited(sensor, {"membrane.prestretch": 8.2})


def test_a_sensor_file_with_the_byte_order_mark_of_windows_editors_is_read(tmp_path):
    sensor = load_sensor("pico_flexx_75mm")
    path = tmp_path / "own.toml"
    path.write_text(sensor_to_toml(sensor), encoding="utf-8-sig")
    assert load_sensor(path).camera == sensor.camera
