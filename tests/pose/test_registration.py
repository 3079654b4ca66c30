"""Registration in cases with closed-form solutions."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.membrane import ObjectSurface
from bubbleviz.pose import (
    ContactPoints,
    InitialPoseFinder,
    Motion,
    Precision,
    Registration,
    about,
    directions,
    motion_between,
    moved,
    object_distance,
    open_axes,
    rows,
    spins,
)
from bubbleviz.simulation import study_object
from tests.membrane.domes import plate

PRECISION = Precision(1e12, 3e-3)
WEAK = 1e-3 * np.eye(6)
MIDDLE = np.array([0.0, 0.0, 0.015])


def contact_of(points, normals, free=None):
    """Contact points whose membrane normals oppose the given ones."""
    center = points.mean(axis=0)
    free = np.zeros((0, 3)) if free is None else free
    return ContactPoints(
        points=points,
        normals=-normals,
        areas_m2=np.full(len(points), 1e-6),
        pressure_pa=np.full(len(points), 2e3),
        friction_pa=np.zeros((0, 3)),
        free=free,
        free_areas_m2=np.full(len(free), 1e-6),
        center=center,
        radius_m=float(np.sqrt(np.mean(np.sum((points - center) ** 2, axis=1)))),
        rest_center=center,
        membrane=np.zeros((0, 3)),
        image_errors=None,
        noise_factor=1.0,
    )


def pose(x=0.004, turn=(0.2, -0.3, 0.5)):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    T[:3, 3] = [x, -0.003, 0.04]
    return T


def known(T, information):
    """A pose known with some information (6, 6)."""
    covariance = np.eye(12)
    covariance[:6, :6] = np.linalg.inv(information)
    return Motion(T, np.zeros(6), covariance, np.zeros(3))


def on_surface(model, T, count=240, keep=None):
    points, normals = model.sample(count, seed=3)
    if keep is not None:
        kept = keep(points, normals)
        points, normals = points[kept], normals[kept]
    return contact_of(points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T)


@pytest.fixture(scope="module")
def frustum():
    return ObjectSurface(study_object("frustum"))


def test_points_on_the_surface_recover_the_pose(frustum):
    T = pose()
    contact = on_surface(frustum, T)
    start = moved(T, np.array([2e-3, -1e-3, 1e-3, 0.04, -0.05, 0.06]), contact.center)
    registration = Registration(frustum, PRECISION)
    one = registration.stage_one(contact, known(start, WEAK), iterations=40)
    two = registration.stage_two(contact, one, known(start, WEAK), iterations=40)
    assert one.fitness == pytest.approx(1.0)
    assert np.abs(motion_between(T, two.T_B_O, contact.center)).max() < 2e-5
    assert two.rmse_m < 1e-5
    assert two.correspondences == len(contact.points)
    assert two.history[0, 0] <= two.history[-1, 0]


def test_registration_is_equivariant_to_rigid_motion(frustum):
    T = pose()
    contact = on_surface(frustum, T, keep=lambda p, n: n[:, 2] < -0.9)
    start = moved(T, np.array([1e-3, 1e-3, 2e-3, 0.05, -0.04, 0.02]), contact.center)
    information = np.diag([1e5, 2e5, 3e5, 10.0, 20.0, 30.0])
    G = pose(0.02, (-0.7, 0.4, 1.1))
    R = np.kron(np.eye(2), G[:3, :3])
    there = contact_of(contact.points @ G[:3, :3].T + G[:3, 3], -contact.normals @ G[:3, :3].T)
    registration = Registration(frustum, PRECISION)
    here = registration.stage_one(contact, known(start, information))
    moved_along = registration.stage_one(there, known(G @ start, R @ information @ R.T))
    off = motion_between(G @ here.T_B_O, moved_along.T_B_O, there.center)
    assert np.abs(off).max() < 1e-5


def test_contact_with_the_wrong_side_does_not_count(frustum):
    T = pose()
    right = on_surface(frustum, T, keep=lambda p, n: n[:, 2] < -0.9)
    wrong = contact_of(right.points, right.normals)  # the membrane would be inside the object
    registration = Registration(frustum, PRECISION)
    assert registration.stage_one(right, known(T, WEAK), iterations=1).fitness > 0.99
    assert registration.stage_one(wrong, known(T, WEAK), iterations=1).fitness == 0.0


def test_face_is_placed_at_the_pressure_weighted_mean_first():
    """Stage one weights by force, stage two by area; the scale of the pressure has no effect."""
    slab = ObjectSurface(plate(half=0.02))
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-4e-3, 4e-3, 9)] * 2))
    height = np.where(x * y > 0.0, 4e-5, -2e-5)  # a saddle: no plane but a level one is nearer
    contact = contact_of(np.column_stack([x, y, height]), np.tile([0.0, 0.0, -1.0], (81, 1)))
    contact = replace(contact, pressure_pa=np.where(height > 0.0, 3e3, 1e3))
    start = moved(np.eye(4), np.array([0.0, 0.0, 3e-4, 0.0, 0.0, 0.0]), contact.center)
    registration, prior = Registration(slab, PRECISION), known(start, WEAK)
    begun = registration.stage_one(contact, prior, iterations=0)
    by_force = np.average(height, weights=contact.pressure_pa)
    for fit, expected in (
        (registration.stage_one(contact, prior, iterations=40), by_force),
        (registration.stage_two(contact, begun, prior, iterations=40), height.mean()),
    ):
        assert fit.T_B_O[2, 3] == pytest.approx(expected, abs=1e-6)
        rmse = np.sqrt(np.mean((height - fit.T_B_O[2, 3]) ** 2))
        assert fit.rmse_m == pytest.approx(rmse, rel=1e-3) and fit.fitness == pytest.approx(1.0)
    strong = known(start, np.diag([1.0, 1.0, 1e8, 1.0, 1.0, 1.0]))
    harder = replace(contact, pressure_pa=7.0 * contact.pressure_pa)
    one, two = (registration.stage_one(each, strong) for each in (contact, harder))
    assert by_force + 2e-5 < one.T_B_O[2, 3] < start[2, 3] - 2e-5
    np.testing.assert_allclose(two.T_B_O, one.T_B_O, atol=1e-9)


def test_free_membrane_pushes_the_object_out(frustum):
    T = pose(turn=(0.0, 0.0, 0.0))
    contact = on_surface(frustum, T, keep=lambda p, n: (n[:, 2] < -0.9) & (p[:, 0] < 0.0))
    # free membrane just inside the side at −x, where the object must not be
    y, z = np.meshgrid(np.linspace(-5e-3, 5e-3, 9), np.linspace(4e-3, 8e-3, 5))
    x = -0.0125 - 0.4375 * z + 3e-3
    free = np.stack([x, y, z], axis=-1).reshape(-1, 3) + T[:3, 3]
    registration = Registration(frustum, PRECISION)
    prior = known(T, np.diag([1e4, 1e10, 1e10, 1e6, 1e6, 1e6]))
    begun = registration.stage_one(contact, prior, iterations=0)
    without = registration.stage_two(contact, begun, prior)
    crowded = contact_of(contact.points, -contact.normals, free)
    begun = registration.stage_one(crowded, prior, iterations=0)
    pushed = registration.stage_two(crowded, begun, prior)
    assert abs(without.T_B_O[0, 3] - T[0, 3]) < 1e-4
    assert 1e-3 < pushed.T_B_O[0, 3] - T[0, 3] < 3.5e-3


def surface_information(points, normals, center):
    J = rows(normals, points, center)
    return 1e10 * J.T @ J


def touched(shape):
    """Points and normals where a plane, a ball of 15 mm or a rod along x of 10 mm touches."""
    if shape == "rod":
        a, x = np.random.default_rng(1).uniform([-0.8, -0.02], [0.8, 0.02], (300, 2)).T
        normals = np.column_stack([np.zeros(300), np.sin(a), -np.cos(a)])
        return np.column_stack([x, 0.01 * np.sin(a), -0.01 * np.cos(a)]), normals
    flat = np.column_stack([np.random.default_rng(0).uniform(-0.01, 0.01, (200, 2)), np.zeros(200)])
    if shape == "plane":
        return flat, np.tile([0.0, 0.0, 1.0], (200, 1))
    out = (flat - MIDDLE) / np.linalg.norm(flat - MIDDLE, axis=1)[:, None]
    return MIDDLE + 0.015 * out, out


def loose(found):
    """The motions that contact does not determine, (6, q)."""
    return found.motions[:, ~found.determined]


def found_directions(shape):
    radius_m = 0.01 if shape == "rod" else 7e-3
    return directions(surface_information(*touched(shape), np.zeros(3)), radius_m)


def test_plane_has_two_translations_and_one_rotation_undetermined():
    found = found_directions("plane")
    assert found.determined.tolist() == [True] * 3 + [False] * 3
    assert np.allclose(loose(found)[[2, 3, 4]], 0.0, atol=1e-9)  # neither lifts nor tilts
    assert np.all(np.diff(found.deviation_m[:3]) >= 0.0)
    shifts, turns = open_axes(loose(found))
    assert np.allclose(np.abs(turns), [[0.0, 0.0, 1.0]], atol=1e-6)
    assert shifts.shape == (2, 3) and np.allclose(shifts[:, 2], 0.0, atol=1e-6)
    assert np.allclose(shifts @ shifts.T, np.eye(2), atol=1e-6)


def test_ball_has_three_rotations_undetermined():
    found = found_directions("ball")
    assert found.determined.tolist() == [True] * 3 + [False] * 3
    for motion in loose(found).T:  # the middle stays where it is
        assert np.allclose(motion[:3] + np.cross(motion[3:], MIDDLE), 0.0, atol=1e-9)
    shifts, turns = open_axes(loose(found))
    assert shifts.shape == (0, 3) and turns.shape == (3, 3)


def test_rod_has_one_translation_and_one_rotation_undetermined():
    found = found_directions("rod")
    assert found.determined.sum() == 4
    assert np.allclose(loose(found)[[1, 2, 4, 5]], 0.0, atol=1e-9)
    for axes in open_axes(loose(found)):
        assert np.allclose(np.abs(axes), [[1.0, 0.0, 0.0]], atol=1e-6)


def test_jacobian_of_distances_is_their_derivative(frustum):
    T = pose()
    contact = on_surface(frustum, T, keep=lambda p, n: n[:, 2] < -0.9)
    at = moved(T, np.array([0.0, 0.0, 4e-4, 0.01, -0.02, 0.0]), contact.center)
    distance = object_distance(frustum, contact.points, at)
    J = -rows(distance.gradient, contact.points, contact.center)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5 if k < 3 else 1e-3
        ahead = object_distance(frustum, contact.points, moved(at, step, contact.center))
        back = object_distance(frustum, contact.points, moved(at, -step, contact.center))
        change = (ahead.signed_m - back.signed_m) / (2.0 * step[k])
        assert np.median(np.abs(change - J[:, k])) < 2e-3 * max(1.0, np.abs(J[:, k]).max())


def test_translations_with_rounding_errors_are_not_rotations():
    motions = np.eye(6)[:, :2].copy()
    motions[3:] = 1e-9 * np.random.default_rng(0).standard_normal((3, 2))
    shifts, turns = open_axes(motions)
    assert len(turns) == 0
    assert np.allclose(shifts @ shifts.T, np.eye(2), atol=1e-6)
    assert [len(axes) for axes in open_axes(np.zeros((6, 0)))] == [0, 0]


def test_spins_are_the_motions_that_rotate():
    """Of a ball about its centre, of a bar that slides along itself none, however it is rounded."""
    arm, slide = np.array([0.001, 0.0, 0.013]), np.array([1.0, 0.0, 0.0, 1e-3, 0.0, 0.0])
    turns = np.vstack([np.cross(np.eye(3), -arm).T, np.eye(3)])
    units = 100.0 * turns  # which move the edge of a patch of 1 cm by 1 m
    np.testing.assert_allclose(spins(units @ np.diag([1.0, 0.7, -1.0])), turns, atol=1e-12)
    both = spins(np.column_stack([slide, units[:, 2]]))
    np.testing.assert_allclose(both, turns * [0.0, 0.0, 1.0], atol=1e-4)
    assert not spins(slide[:, None]).any() and not spins(np.zeros((6, 0))).any()


def test_precision_is_the_worse_of_noise_and_model_error():
    """0.24 mm of error of the model over a patch of 3 mm; a pixel of 1 mm on each mm²."""
    noisy, exact = Precision(1e12, 1e-9), Precision(1e30, 3e-3)
    assert noisy.per_area == pytest.approx(1e12, rel=1e-3)
    assert exact.per_area == pytest.approx(1.0 / (2.4e-4 * 3e-3) ** 2, rel=1e-3)
    assert Precision(exact.per_area, 3e-3).per_area == pytest.approx(0.5 * exact.per_area)


def test_normals_of_a_noisier_image_tell_less(frustum):
    """Errors of the model are then common to an area twice as wide."""
    T, precision = pose(), Precision(1e30, 3e-3)
    contact = on_surface(frustum, T)
    registration, start = Registration(frustum, precision), known(T, WEAK)
    quiet = registration.stage_one(contact, start)
    noisy = registration.stage_one(replace(contact, noise_factor=8.0), start)
    np.testing.assert_allclose(noisy.surface, 0.25 * quiet.surface)


def test_initial_poses_are_independent_of_the_object_origin(frustum):
    shift = np.array([0.03, -0.02, 0.05])
    away = ObjectSurface(replace(frustum.obj, vertices=frustum.obj.vertices + shift))
    tip = on_surface(frustum, pose(), keep=lambda points, normals: points[:, 2] < 1e-6)
    starts, others = (InitialPoseFinder(model).starts(tip) for model in (frustum, away))
    others[:, :3, 3] += others[:, :3, :3] @ shift
    differences = np.abs(others[:, None] - starts).max(axis=(2, 3))
    assert differences.min(axis=0).max() < 1e-9  # faces that are alike come in any order


def test_initial_poses_cover_all_rotations():
    """An oblong slab on its large face: one of them is within half a step of 30°."""
    slab = plate(half=0.01)
    model = ObjectSurface(replace(slab, vertices=slab.vertices * [1.0, 0.5, 1.0]))
    x, y = (
        axis.ravel()
        for axis in np.meshgrid(np.linspace(-9e-3, 9e-3, 13), np.linspace(-4e-3, 4e-3, 7))
    )
    points, normals = np.column_stack([x, y, 0.0 * x]), np.tile([0.0, 0.0, -1.0], (len(x), 1))
    for turn in np.radians([0.0, 40.0, 100.0, 160.0]):
        T = pose(turn=(0.1, -0.2, 0.0)) @ pose(turn=(0.0, 0.0, turn))
        R = T[:3, :3]
        starts = InitialPoseFinder(model).starts(contact_of(points @ R.T + T[:3, 3], normals @ R.T))
        cosine = 0.5 * (np.einsum("ij,kij->k", R, starts[:, :3, :3]) - 1.0)
        near = np.argmax(cosine)
        assert cosine[near] > np.cos(np.radians(16.0))
        assert np.linalg.norm(starts[near, :3, 3] - T[:3, 3]) < 1e-3


@pytest.mark.parametrize("side", [(1.0, 1.0), (-1.0, 1.0), (0.0, 0.0)])
def test_an_initial_pose_touches_where_the_patch_is_on_a_face(side):
    """A slab touched at a corner or in the middle; beyond it the membrane rises."""
    slab = ObjectSurface(plate(half=0.02))
    around = np.linspace(-0.012, 0.012, 13)
    x, y = (axis.ravel() for axis in np.meshgrid(around, around))
    places = np.column_stack([x + 0.016 * side[0], y + 0.016 * side[1], 0.0 * x])
    beyond = np.maximum(np.abs(places[:, :2]).max(axis=1) - 0.02, 0.0)
    near = np.maximum(np.abs(x), np.abs(y)) < 7e-3
    on, free = near & (beyond == 0.0), ~near | (beyond > 0.0)
    places[:, 2] = np.where(beyond > 0.0, 2e-3, np.where(near, 0.0, -2e-3))
    T = pose()
    points, normals = places @ T[:3, :3].T + T[:3, 3], np.tile([0.0, 0.0, -1.0], (on.sum(), 1))
    contact = contact_of(points[on], normals @ T[:3, :3].T, points[free])
    starts = InitialPoseFinder(slab).starts(contact)
    tilt = starts[:, :3, 2] @ T[:3, 2]  # the slab looks the same after quarter turns
    apart = [motion_between(T, start, contact.center) for start in starts[tilt > 0.99]]
    off = [np.linalg.norm(motion[:3]) for motion in apart if np.linalg.norm(motion[3:]) < 0.3]
    assert min(off) < 6e-3


def test_opposite_motions_cancel():
    T, center = pose(), np.array([0.01, 0.02, 0.03])
    motion = np.array([1e-3, 2e-3, -3e-3, 0.1, -0.2, 0.3])
    assert np.allclose(motion_between(T, moved(T, motion, center), center), motion)
    small = 1e-6 * motion
    other = np.array([-0.02, 0.01, 0.05])
    assert np.allclose(
        moved(T, small, center), moved(T, about(center, other) @ small, other), atol=1e-11
    )


@pytest.mark.parametrize("wrong", [0.0, 2.5e-3])
def test_fit_ends_at_the_smallest_misfit(frustum, wrong):
    """Moved any way from the end, noisy points fit worse: by steps, no derivative of ours."""
    T = pose()
    clean = on_surface(frustum, T, keep=lambda p, n: (n[:, 2] < -0.9) | (p[:, 2] < 0.02))
    rng = np.random.default_rng(4)
    off = 3e-4 * rng.standard_normal(len(clean.points))
    off[::9] += wrong  # outliers, of one sign
    contact = contact_of(clean.points - off[:, None] * clean.normals, -clean.normals)
    registration, prior = Registration(frustum, PRECISION), known(T, 1e-3 * WEAK)
    begun = registration.stage_one(contact, prior, iterations=0)
    fit = registration.stage_two(contact, begun, prior, iterations=100)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 5e-5 if k < 3 else 5e-5 / contact.radius_m
        back, here, ahead = (
            registration.at(contact, fit, moved(fit.T_B_O, s * step, contact.center)).cost
            for s in (-1.0, 0.0, 1.0)
        )
        # Newton's step to the minimum, in units of the one taken
        assert abs(0.5 * (ahead - back) / (ahead + back - 2.0 * here)) < 0.4
    assert np.linalg.norm(motion_between(T, fit.T_B_O, contact.center)[:3]) < 3e-4
