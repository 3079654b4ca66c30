"""The shipped objects: closed, oriented outward, of the documented size."""

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.files import presets_folder, write_ply
from bubbleviz.rigid_object import load_object, object_mesh

NAMES = sorted(path.stem for path in presets_folder("objects").iterdir())


def volume(obj):
    a, b, c = (obj.vertices[obj.triangles[:, k]] for k in range(3))
    return np.einsum("ij,ij->", np.cross(a, b), c) / 6.0


@pytest.mark.parametrize("name", NAMES)
def test_object_is_watertight_and_touches_its_origin_from_above(name):
    obj = load_object(name)
    start, end = obj.triangles.ravel(), np.roll(obj.triangles, -1, axis=1).ravel()
    forward = set(zip(start.tolist(), end.tolist(), strict=True))
    assert len(forward) == len(start)
    assert forward == {(b, a) for a, b in forward}
    assert obj.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert 0.02 < np.ptp(obj.vertices, axis=0).max() < 0.1


@pytest.mark.parametrize(
    ("name", "exact", "tolerance"),
    [
        ("sphere", 4 / 3 * np.pi * 0.015**3, 0.005),
        ("two_spheres", 8 / 3 * np.pi * 0.009**3, 0.015),
        ("torus", 2 * np.pi**2 * 0.018 * 0.006**2, 0.01),
        ("cylinder", np.pi * 0.012**2 * 0.04, 0.002),
        ("two_legged_toy", 0.018 * (0.042 * 0.04 - 0.018 * 0.016), 1e-6),
        ("bridge", 0.025 * (0.044 * 0.024 - 0.5 * np.pi * 0.012**2), 0.005),
        ("hex_nut", 0.01 * (0.024**2 * np.sqrt(3) / 2 - np.pi * 0.007**2), 0.005),
        ("frustum", 0.04 / 3 * (0.06**2 + 0.06 * 0.025 + 0.025**2), 0.001),
    ],
)
def test_volume_equals_that_of_the_ideal_shape(name, exact, tolerance):
    assert volume(load_object(name)) == pytest.approx(exact, rel=tolerance)


def test_units(tmp_path):
    made, metres = load_object("frustum"), tmp_path / "f.ply"
    write_ply(metres, made.vertices, {}, made.triangles)
    for name in ("f_mm.ply", "g.ply"):
        write_ply(tmp_path / name, 1e3 * made.vertices, {}, made.triangles)
    np.testing.assert_allclose(object_mesh(tmp_path / "f_mm.ply")[0], made.vertices, atol=1e-8)
    np.testing.assert_allclose(object_mesh(tmp_path / "g.ply", "mm")[0], made.vertices, atol=1e-8)
    with pytest.raises(InputError, match=r"g\.ply.*millimetres"):
        object_mesh(tmp_path / "g.ply")
    with pytest.raises(InputError, match=r"f\.ply.*only"):
        object_mesh(metres, "mm")
    with pytest.raises(InputError, match=r"one of: .*frustum"):
        load_object("nonesuch")
