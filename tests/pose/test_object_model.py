"""Objects made ready: closest places, smooth normals, creases, refusals, symmetries, samples."""

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.membrane.reference_mesh import build_mesh
from bubbleviz.pose.depth_image.object_contact import contact_samples
from bubbleviz.pose.object_model import ObjectModel, check_size
from bubbleviz.pose.start_finder import touching_directions
from bubbleviz.pose.symmetry import symmetries
from bubbleviz.rigid_object import RigidObject
from bubbleviz.sensor import load_sensor
from bubbleviz.study.presses import made


def test_closest_places_on_a_ball_are_radial():
    model = ObjectModel(made("sphere"))
    middle = np.array([0.0, 0.0, 0.015])
    away = np.random.default_rng(0).standard_normal((50, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    found = model.closest(middle + 0.02 * away)
    assert np.abs(found.place - (middle + 0.015 * away)).max() < 2e-4
    assert np.einsum("ij,ij->i", found.normal, away).min() > np.cos(
        np.radians(1.0)
    )  # facets turn by 4°
    assert model.creases is None


def test_normals_do_not_smooth_over_an_edge():
    model = ObjectModel(made("frustum"))
    found = model.closest(np.array([[0.012, 0.0, -0.001], [0.04, 0.0, 0.02]]))
    side = np.array([0.040, 0.0, -0.0175]) / np.hypot(0.040, 0.0175)
    assert np.allclose(found.normal, [[0.0, 0.0, -1.0], side], atol=1e-4)


def test_creases_of_a_nut_are_its_edges_and_not_those_of_its_mesh():
    model = ObjectModel(made("hex_nut"))
    points = np.asarray(model.creases.tree.data)
    radius = np.hypot(points[:, 0], points[:, 1])
    on_end = (points[:, 2] < 1e-6) | (points[:, 2] > 0.01 - 1e-6)
    outer = radius > 0.0119
    hole = np.abs(radius - 0.007) < 2e-4
    assert np.all(outer | hole)
    # between the ends only the six corners run, at 12/cos 30° mm
    assert np.allclose(radius[~on_end], 0.012 / np.cos(np.pi / 6.0), atol=1e-5)


def test_samples_are_on_the_surface_and_spread():
    model = ObjectModel(made("bridge"))
    points, normals = contact_samples(model, 2e-3)
    assert np.linalg.norm(points - model.closest(points).place, axis=1).max() < 1e-6
    assert np.allclose(np.linalg.norm(normals, axis=2), 1.0)
    expected = model.area_m2 / 2e-3**2
    assert expected < len(points) < 3.0 * expected


def test_a_mesh_without_area_is_refused():
    line = RigidObject(
        "line", np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]]), np.array([[0, 1, 2]])
    )
    with pytest.raises(InputError, match="object line: its triangles have no area"):
        ObjectModel(line)


def test_millimetres_taken_for_metres_are_refused():
    mesh = build_mesh(load_sensor("pico_flexx_75mm"))
    obj = made("frustum")
    check_size(obj, mesh)
    with pytest.raises(InputError, match="is it in millimetres"):
        check_size(RigidObject("big", 1e3 * obj.vertices, obj.triangles), mesh)


GROUPS = {
    "frustum": 4, "two_legged_toy": 2, "cross": 8, "hex_nut": 12, "sphere": 1, "cylinder": 720,
}  # fmt: skip


@pytest.mark.parametrize(("name", "count"), GROUPS.items())
def test_symmetries(name, count):
    model = ObjectModel(made(name))
    found = symmetries(model)
    assert len(found) == count
    assert np.allclose(found[0], np.eye(4))
    for T in found[:: max(1, len(found) // 9)]:
        turned = model.obj.vertices @ T[:3, :3].T + T[:3, 3]
        way = np.linalg.norm(turned - model.closest(turned).place, axis=1)
        assert way.max() < 5e-3 * model.size_m


def test_stable_faces_come_first():
    chosen = touching_directions(ObjectModel(made("hex_nut")))
    assert np.allclose(np.abs(chosen[:2, 2]), 1.0, atol=1e-2)
    assert len(chosen) >= 8  # its two ends and six sides
