"""Object models: closest points, smooth normals, creases, refusals, samples."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from bubbleviz.membrane import ObjectSurface
from bubbleviz.pose import contact_samples, object_distance, touching_directions
from bubbleviz.rigid_object import RigidObject
from bubbleviz.simulation import study_object


def test_closest_points_on_a_ball_are_radial():
    model = ObjectSurface(study_object("sphere"))
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
    model = ObjectSurface(study_object("frustum"))
    found = model.closest(np.array([[0.012, 0.0, -0.001], [0.04, 0.0, 0.02]]))
    side = np.array([0.040, 0.0, -0.0175]) / np.hypot(0.040, 0.0175)
    assert np.allclose(found.normal, [[0.0, 0.0, -1.0], side], atol=1e-4)


def test_creases_of_a_nut_are_its_geometric_edges():
    model = ObjectSurface(study_object("hex_nut"))
    points = np.asarray(model.creases.tree.data)
    radius = np.hypot(points[:, 0], points[:, 1])
    on_end = (points[:, 2] < 1e-6) | (points[:, 2] > 0.01 - 1e-6)
    outer = radius > 0.0119
    hole = np.abs(radius - 0.007) < 2e-4
    assert np.all(outer | hole)
    # between the ends only the six corners run, at 12/cos 30° mm
    assert np.allclose(radius[~on_end], 0.012 / np.cos(np.pi / 6.0), atol=1e-5)


def test_samples_are_on_the_surface_and_spread():
    model = ObjectSurface(study_object("bridge"))
    points, normals = contact_samples(model, 2e-3)
    assert np.linalg.norm(points - model.closest(points).place, axis=1).max() < 1e-6
    assert np.allclose(np.linalg.norm(normals, axis=2), 1.0)
    expected = model.area_m2 / 2e-3**2
    assert expected < len(points) < 3.0 * expected


@pytest.mark.parametrize("name", ["cross", "two_legged_toy", "hex_nut", "bridge"])
def test_distances_are_those_of_a_signed_distance_field(name):
    """Inside and outside, near faces and edges; the sign by counting ray crossings."""
    import open3d

    obj = study_object(name)
    rng = np.random.default_rng(0)
    low, high = obj.vertices.min(axis=0), obj.vertices.max(axis=0)
    points = rng.uniform(low - 4e-3, high + 4e-3, (1500, 3))
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(obj.vertices.astype("f4"), obj.triangles.astype("u4"))
    exact = scene.compute_signed_distance(points.astype("f4"), nsamples=5).numpy()
    found = object_distance(ObjectSurface(obj), points, np.eye(4))
    clear = np.abs(exact) > 5e-4
    assert np.mean(np.sign(found.signed_m[clear]) == np.sign(exact[clear])) > 0.995
    beside = clear & ~found.over
    assert beside.sum() > 50
    assert np.abs(np.abs(found.signed_m) - np.abs(exact))[beside].max() < 1e-6
    # over a face the distance is that from its plane, which bends with a smooth surface
    assert np.median(np.abs(np.abs(found.signed_m) - np.abs(exact))[found.over]) < 1e-6


def test_brick_rests_on_its_largest_faces_first():
    x, y, z = np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij")
    corners = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    faces = ConvexHull(corners).simplices
    chosen = touching_directions(
        ObjectSurface(RigidObject("brick", corners * [2e-2, 5e-3, 1e-2], faces))
    )
    assert np.allclose(np.abs(chosen[:6]), np.repeat(np.eye(3)[[1, 2, 0]], 2, axis=0), atol=1e-3)
    assert np.allclose(chosen[:6:2], -chosen[1:6:2], atol=1e-3)


@pytest.mark.parametrize(("slope_deg", "both"), [(12.0, True), (6.0, False)])
def test_roof_rests_on_both_slopes_unless_equivalent(slope_deg, both):
    slope = np.radians(slope_deg)
    gable = np.array([[-0.01, 0.0], [0.01, 0.0], [0.0, 0.01 * np.tan(slope)]])
    corners = np.array([[x, y, z] for y in (-0.02, 0.02) for x, z in gable])
    roof = RigidObject("roof", corners, ConvexHull(corners).simplices)
    chosen = touching_directions(ObjectSurface(roof))
    up = chosen[chosen[:, 2] > np.cos(np.radians(20.0))]
    assert len(up) == (2 if both else 1)
    np.testing.assert_allclose(np.abs(up[:, 0]), np.sin(slope), atol=1e-3)


def test_stable_faces_come_first():
    chosen = touching_directions(ObjectSurface(study_object("hex_nut")))
    assert np.allclose(np.abs(chosen[:2, 2]), 1.0, atol=1e-2)
    assert len(chosen) >= 8  # its two ends and six sides
