"""Objects pressed into the exact membrane: against its meridian's equations and conservation."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from domes import AIR, CHAMBER, GAUGE, A, H, dome, force, gas_of, plate, pose, unbalanced_n

from bubbleviz.membrane import (
    EllipsoidalCap,
    ForwardModel,
    Gas,
    ObjectSurface,
    RubberForward,
    RubberMembrane,
    inverse_metric,
    mesh_cap,
    spherical_cap,
)
from bubbleviz.rigid_object import RigidObject, load_object
from tests.oracles.axial_mesh import swept_mesh
from tests.oracles.exact_bubble import Bubble, axial_contact
from tests.oracles.rubber_oracle import AxialRubber

BALL = 0.015  # of the preset


def forward(nodes, prestretch, slack=None):
    return RubberForward(*dome(nodes, prestretch, slack))


def sheet(nodes, truth):
    """The mesh of a sheet that was flat before it was bulged, from its exact meridian."""
    mesh = swept_mesh(truth.rest, nodes)
    free = truth.rest.s_m / truth.prestretch
    flat = swept_mesh(replace(truth.rest, r_m=free, z_m=0.0 * free), nodes)
    gauge = truth.gauge_pressure_pa
    membrane = RubberMembrane(mesh, gauge, inverse_metric(flat), truth.mu_h_n_per_m)
    return RubberForward(membrane, gas_of(mesh, gauge))


def assert_equilibrium(contact):
    assert contact.converged
    assert contact.balance_residual < 1e-6
    assert contact.penetration_m < 1e-8
    assert contact.contact_pressure_pa.min() >= 0.0


# -- against the equations of the meridian ------------------------------------------------------


def errors(contact, exact):
    """Of force and of the gas pressure's change, relative."""
    assert_equilibrium(contact)
    return np.abs(
        [
            force(contact) / exact.force_n - 1.0,
            contact.gas_pressure_change_pa / exact.gas_pressure_change_pa - 1.0,
        ]
    )


@pytest.mark.parametrize(("depth", "ball"), [(0.003, np.inf), (0.009, np.inf), (0.008, BALL)])
def test_dome_pressed_by_plate_and_ball(depth, ball):
    """Presses to 45 % of the dome's height, on two meshes."""
    exact = AxialRubber.dome(A, H, 1.2, GAUGE).press(depth, ball)
    obj = load_object("sphere") if np.isfinite(ball) else plate()
    for nodes, most in ((250, 0.06), (1200, 0.015)):
        contact = forward(nodes, 1.2).press(obj, pose(z=H - depth))
        assert errors(contact, exact).max() < most


@pytest.mark.parametrize("ball", [np.inf, BALL])
def test_bulged_sheet_with_varying_tension(ball):
    truth = AxialRubber(A, 60.0, 1.3, GAUGE)
    along, around = truth.rest.tensions_n_per_m[-1]
    assert around < 0.8 * along
    depth = 0.3 * truth.height_m
    obj = load_object("sphere") if np.isfinite(ball) else plate()
    model = sheet(1200, truth)
    left = model.membrane.rest_force[model.mesh.free]
    load = GAUGE * model.mesh.areas[model.mesh.free]
    assert np.sqrt(np.mean(left**2)) < 0.03 * np.sqrt(np.mean(load**2))
    contact = model.press(obj, pose(z=truth.height_m - depth))
    assert errors(contact, truth.press(depth, ball)).max() < 0.02


def test_without_prestretch_it_is_a_film_of_constant_tension():
    depth = 0.007
    exact = axial_contact(Bubble(A, H, GAUGE, AIR, CHAMBER), depth)
    contact = forward(1200, None).press(plate(), pose(z=H - depth))
    assert errors(contact, exact).max() < 5e-3
    touching = contact.contact_pressure_pa > 0.0
    held = GAUGE + contact.gas_pressure_change_pa
    assert np.median(contact.contact_pressure_pa[touching]) == pytest.approx(held, rel=0.02)


def test_small_press_on_a_flat_sheet_equals_the_linear_model():
    """λ → ∞ and little curvature: the paper's model is the limit."""
    height = 0.02 * A
    mesh = mesh_cap(spherical_cap(A, height), 600)
    gauge = 100.0
    tension = gauge * (A**2 + height**2) / (4 * height)
    there = pose(0.006, 0.0, height - 1e-4)
    gas = gas_of(mesh, gauge)
    contact = RubberForward(RubberMembrane.uniform(mesh, gauge, tension), gas).press(plate(), there)
    linear = ForwardModel(mesh, tension, gas).press(plate(), there)
    assert_equilibrium(contact)
    assert force(contact) == pytest.approx(force(linear), rel=0.01)
    difference = contact.displacement_m - linear.displacement_m
    assert np.abs(difference).max() < 0.02 * np.abs(linear.displacement_m).max()


# -- conservation -------------------------------------------------------------------------------


@pytest.mark.parametrize("slack", [None, 1.5e-4])
def test_contact_rim_and_gas_are_in_balance(slack):
    """An oval pressed off its middle: rim reaction + pressure × rim area = contact force."""
    mesh = mesh_cap(EllipsoidalCap.of((0.055, 0.040), 0.030), 500)
    membrane = RubberMembrane.uniform(mesh, 5000.0, 130.0, 1.2, slack)
    contact = RubberForward(membrane, gas_of(mesh, 5000.0)).press(
        load_object("two_legged_toy"), pose(0.01, 0.004, 0.024)
    )
    assert_equilibrium(contact)
    rim = mesh.nodes[mesh.rim, :2]
    x, y = rim[np.argsort(np.arctan2(*rim.T))].T
    opening = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    gauge = 5000.0 + contact.gas_pressure_change_pa
    # A rim that gives changes its opening by some thousandths.
    x = mesh.nodes + contact.displacement_3d_m
    gas = gauge * membrane.volume_gradient(x).sum(axis=0)
    assert gas[2] == pytest.approx(gauge * opening, rel=1e-9 if not slack else 0.01)
    np.testing.assert_allclose(unbalanced_n(membrane, contact), 0.0, atol=1e-5)
    given = np.linalg.norm(contact.displacement_3d_m[mesh.rim], axis=1).max()
    assert given < 1e-3 if slack else given == 0.0
    V0 = CHAMBER + mesh.cap_volume()
    volume = CHAMBER + mesh.cap_volume(contact.displacement_3d_m)
    p = (AIR + 5000.0) * (V0 / volume - 1.0)
    assert contact.gas_pressure_change_pa == pytest.approx(p, rel=1e-9)


@pytest.mark.parametrize("prestretch", [1.05, 1.5])
def test_work_of_the_object_equals_the_stored_energy(prestretch):
    """F = dE/dδ of a cylinder's flat end, which touches the same nodes in all three presses."""
    model, step = forward(300, prestretch), 1e-6
    depth = 0.004
    low, middle, high = (
        model.press(load_object("cylinder"), pose(0.003, 0.0, H - depth - k * step))
        for k in (-1, 0, 1)
    )
    assert_equilibrium(middle)
    work = (high.energy_j - low.energy_j) / (2.0 * step)
    assert force(middle) == pytest.approx(work, rel=1e-5)


def test_nut_keeps_sharp_edges_and_ball_is_smooth():
    """Normals 0.3 mm from an edge of 60° are those of the sides; a ball's point away from it."""
    nut, turn = load_object("hex_nut"), np.radians(60.0 * np.arange(6))
    mid = 0.5 * (nut.vertices[:, 2].min() + nut.vertices[:, 2].max())
    radius = np.hypot(*nut.vertices[:, :2].T).max()
    corner = nut.vertices[np.argmax(np.hypot(*nut.vertices[:, :2].T)), :2]
    first = np.arctan2(corner[1], corner[0])
    for k in turn:
        a, b = (
            radius * np.array([np.cos(first + k + d), np.sin(first + k + d)])
            for d in (0.0, np.pi / 3)
        )
        along, normal = (b - a) / radius, (a + b) / np.linalg.norm(a + b)
        for place in (a + 3e-4 * along, b - 3e-4 * along):
            point = np.append(place + 5e-4 * normal, mid)
            out = -np.append(normal, 0.0)
            found = ObjectSurface(nut).planes(point[None], out[None], np.eye(4), 5e-3)
            assert found.gap[0] == pytest.approx(5e-4, rel=1e-3)
            np.testing.assert_allclose(found.normal[0], -out, atol=1e-6)
    ball = load_object("sphere")
    away = np.random.default_rng(0).standard_normal((50, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    found = ObjectSurface(ball).planes([0.0, 0.0, 0.015] + 0.015 * away, -away, np.eye(4), 5e-3)
    np.testing.assert_allclose(found.gap, 0.0, atol=1e-4)
    assert np.einsum("ij,ij->i", found.normal, away).min() > np.cos(np.radians(1.0))
    curvature = (np.eye(3) - away[:, :, None] * away[:, None, :]) / 0.015
    np.testing.assert_allclose(found.turn, curvature, atol=0.15 / 0.015)  # of facets, smoothed


def test_a_sharp_edge_is_rounded_by_the_radius_asked_for():
    """Distances, normals and their turn around the edge of a cylinder's flat end."""
    R, r = 0.012, 5e-4
    rng = np.random.default_rng(0)
    azimuth, slope = rng.uniform(0.0, 2.0 * np.pi, 200), rng.uniform(0.05, 0.5 * np.pi - 0.05, 200)
    away = rng.uniform(-1e-4, 2e-3, 200)
    around = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth])
    down = np.array([0.0, 0.0, -1.0])
    normal = np.sin(slope)[:, None] * around + np.cos(slope)[:, None] * down
    points = (R - r) * around - r * down + (r + away)[:, None] * normal
    found = ObjectSurface(load_object("cylinder"), r).planes(points, -normal, np.eye(4), 0.01)
    np.testing.assert_allclose(found.gap, away, atol=1e-5)  # 96 sides: within 6 µm
    np.testing.assert_allclose(found.normal, normal, atol=0.035)
    across = np.cross(np.cross(around, down), normal)
    turn = np.einsum("ki,kij,kj->k", across, found.turn, across)
    np.testing.assert_allclose(turn, 1.0 / (r + away), rtol=0.02)


@pytest.mark.parametrize("rounding_m", [0.0, 5e-4])
def test_object_with_inward_normals_gives_the_same_press(rounding_m):
    obj = load_object("hex_nut")
    turned = replace(obj, triangles=obj.triangles[:, ::-1])
    rng = np.random.default_rng(0)
    low, high = obj.vertices.min(axis=0) - 2e-3, obj.vertices.max(axis=0) + 2e-3
    points = rng.uniform(low, high, (300, 3))
    out = np.tile([0.0, 0.0, 1.0], (300, 1))
    one, other = (
        ObjectSurface(each, rounding_m).planes(points, out, np.eye(4), 0.01)
        for each in (obj, turned)
    )
    assert (one.gap < 0.0).any() and (one.gap > 1e-3).any()
    clear = np.isfinite(one.gap) & (np.abs(one.gap) > 1e-5)
    np.testing.assert_allclose(other.gap[clear], one.gap[clear], atol=1e-8)


def test_sheet_is_contacted_from_both_sides_within_its_edge():
    """It has no inside: the side of the membrane is outside; its plane ends at its edge."""
    square = plate(half=0.01)
    for order in ([0, 1, 2], [0, 2, 1]):
        sheet = replace(square, vertices=square.vertices[:4], triangles=square.triangles[:2, order])
        points = np.array([[2e-3, 1e-3, -5e-4], [-3e-3, 4e-3, 7e-4], [0.013, 0.0, -5e-4]])
        out = np.tile([0.0, 0.0, 1.0], (3, 1))
        found = ObjectSurface(sheet).planes(points, out, np.eye(4), 0.01)
        np.testing.assert_allclose(found.gap, [5e-4, -7e-4, np.inf], atol=1e-9)
        np.testing.assert_allclose(found.normal[:2], -out[:2], atol=1e-9)


def test_point_beyond_the_middle_of_a_thin_plate_returns_to_its_side():
    """Nearer to the far side: that one's normal looks along the membrane's, not against it."""
    slab = plate(half=0.02, thickness=2e-3)
    points = np.array([[1e-3, 2e-3, 0.4e-3], [3e-3, -2e-3, 1.7e-3]])
    out = np.tile([0.0, 0.0, 1.0], (2, 1))
    found = ObjectSurface(slab).planes(points, out, np.eye(4), 0.01)
    np.testing.assert_allclose(found.gap, -points[:, 2], rtol=1e-6)
    np.testing.assert_allclose(found.normal, -out, atol=1e-9)


def test_newton_converges_quadratically_on_a_curved_object():
    """Where a ball carries much, its loads turn as the membrane slides along it."""
    contact = forward(600, None).press(load_object("sphere"), pose(0.010, 0.0, H - 0.013))
    assert_equilibrium(contact)
    assert contact.iterations < 30


def test_without_the_linear_model_the_object_approaches_from_outside():
    """A ring pressed deep at the side: Newton's method from the linear equilibrium diverges."""
    model = forward(200, 1.5)
    assert_equilibrium(model.press(load_object("torus"), pose(0.02, 0.0, H - 0.012)))


def test_no_object_no_change():
    contact = forward(300, 1.2).press(load_object("sphere"), pose(z=0.03))
    assert_equilibrium(contact)
    assert np.abs(contact.displacement_3d_m).max() < 1e-12
    assert contact.iterations == 0


def frustum(fillet_m):
    """A four-sided frustum, its narrow end down, with edges of a radius."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=fillet_m).vertices
    ends = ((0.0, 0.0124), (0.04, 0.0297))
    corners = np.array(
        [(x * half, y * half, z) for z, half in ends for x in (-1, 1) for y in (-1, 1)]
    )
    points = (corners[:, None] + ball).reshape(-1, 3)
    hull = trimesh.convex.convex_hull(points - [0.0, 0.0, points[:, 2].min()])
    return RigidObject("frustum", np.array(hull.vertices), np.array(hull.faces))


def test_curvature_is_the_derivative_of_the_normal_on_and_beside_facets():
    surface, rng = ObjectSurface(frustum(2e-3), 5e-4), np.random.default_rng(0)
    places, normals = surface.sample(20_000)
    low = places[:, 2] < 2e-3  # fillets of the narrow end
    points, out = places[low] + 5e-4 * normals[low], -normals[low]
    step = rng.standard_normal(points.shape)
    step -= np.einsum("ij,ij->i", step, out)[:, None] * out
    step *= 1e-6 / np.linalg.norm(step, axis=1)[:, None]
    before, here, after = (
        surface.planes(points + k * step, out, np.eye(4), 0.01) for k in (-1, 0, 1)
    )
    turned = (after.normal - before.normal) / 2.0
    off = np.linalg.norm(turned - np.einsum("kij,kj->ki", here.turn, step), axis=1)
    curved = np.abs(here.normal).max(axis=1) < 0.999
    # of the turn along a fillet; a few steps cross the border of a facet
    assert np.quantile(off[curved], 0.95) < 0.1 * 1e-6 / 2e-3


def test_fillets_finer_than_the_mesh_do_not_prevent_an_equilibrium():
    """Newton's method alternates between their facets, for lack of nodes on them."""
    model, there = forward(800, 1.2), pose(0.003, 0.0021, H - 0.004)
    contact = model.press(frustum(5e-4), there)
    assert contact.converged and contact.stable
    assert contact.balance_residual > 1e-6, "does not alternate: proves nothing"
    assert contact.penetration_m < 1e-6
    assert np.abs(unbalanced_n(model.membrane, contact)).max() < 1e-3 * force(contact)
    nearby = [model.press(frustum(5e-4), pose(0.003, 0.0021, H - d)) for d in (0.0038, 0.0042)]
    assert force(nearby[0]) < force(contact) < force(nearby[1])
    assert contact.iterations < 60


def test_a_press_does_not_depend_on_earlier_poses():
    obj, model = load_object("cylinder"), forward(300, 1.2)
    poses = [pose(0.004, 0.0, H - d) for d in (0.002, 0.005, 0.008)]
    there = [model.press(obj, pose) for pose in poses]
    back = [model.press(obj, pose) for pose in reversed(poses)]
    for a, b in zip(there, reversed(back), strict=True):
        np.testing.assert_array_equal(a.displacement_3d_m, b.displacement_3d_m)


# -- where there is no equilibrium --------------------------------------------------------------


@pytest.mark.parametrize(("chamber", "stable"), [(1e-5, True), (10.0, False)])
def test_film_beyond_the_hemisphere_is_stable_only_with_little_gas(chamber, stable):
    """A soap bubble of more than half a sphere grows at constant pressure."""
    height = 1.4 * A
    mesh = mesh_cap(spherical_cap(A, height), 400)
    tension = GAUGE * (A**2 + height**2) / (4 * height)
    gas = Gas(AIR + GAUGE, chamber + mesh.cap_volume(), mesh.areas)
    model = RubberForward(RubberMembrane.uniform(mesh, GAUGE, tension), gas)
    contact = model.press(load_object("sphere"), pose(z=height + 0.01))
    assert contact.stable is stable
    assert contact.converged is stable
