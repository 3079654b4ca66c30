"""Objects that stick to the exact membrane and slip over it: exact sheets, meridians, work."""

import numpy as np
import pytest
from domes import AIR, GAUGE, A, H, dome, plate, pose

from bubbleviz.membrane import Gas, MembraneMesh, RubberForward, RubberMembrane
from bubbleviz.rigid_object import load_object
from bubbleviz.simulation import study_object
from tests.oracles.rubber_oracle import AxialRubber


def force(contact):
    return contact.nodal_force_n.sum(axis=0)


def torque(contact, mesh, about=0.0):
    """About a vertical axis at x, N·m."""
    away = mesh.deformed(contact.displacement_3d_m) - [about, 0.0, 0.0]
    return np.cross(away, contact.nodal_force_n).sum(axis=0)[2]


def across(contact):
    """Size of the forces across vertical normals, N."""
    return np.linalg.norm(contact.nodal_force_n[:, :2], axis=1)


def assert_equilibrium(contact):
    assert contact.converged and contact.stable
    assert contact.balance_residual < 1e-6
    assert contact.penetration_m < 1e-8
    assert contact.contact_pressure_pa.min() >= 0.0
    assert contact.stick_error_m < 1e-8  # 0.01 mm would do
    assert contact.cone_violation < 1e-9


# -- a flat sheet that a disc holds: its plane elasticity is solved apart -------------------------

INNER, OUTER = 0.0116, 0.04  # m; the cylinder's radius is 12 mm


def flat_sheet(sectors, rings, prestretch):
    """A round sheet at rest with nodes on the edge of the stuck disc, and a large gas volume."""
    radii = np.concatenate(
        [np.linspace(0.0, INNER, 4)[1:], np.geomspace(INNER, OUTER, rings + 1)[1:]]
    )
    turn = 2 * np.pi * np.arange(sectors) / sectors
    circles = [r * np.c_[np.cos(turn), np.sin(turn), 0 * turn] for r in radii]
    nodes = np.vstack([[[0.0, 0.0, 0.0]], *circles])
    k, after = np.arange(sectors), (np.arange(sectors) + 1) % sectors
    triangles = [np.c_[0 * k, 1 + k, 1 + after]]
    for ring in range(len(radii) - 1):
        a, b = 1 + ring * sectors, 1 + (ring + 1) * sectors
        triangles += [np.c_[a + k, b + k, b + after], np.c_[a + k, b + after, a + after]]
    rim = np.zeros(len(nodes), bool)
    rim[-sectors:] = True
    mesh = MembraneMesh(nodes, np.vstack(triangles), rim)
    rubber = RubberMembrane.uniform(mesh, 1.0, 100.0, prestretch)  # 1 Pa: hardly any gauge
    return RubberForward(rubber, Gas(AIR + 1.0, 10.0, mesh.areas))


def moved_by_a_disc(model, x, twist):
    """Change of force and torque as a cylinder's end that sticks 0.1 mm deep moves by a little."""
    poses = [pose(z=-1e-4), pose(x, 0.0, -1e-4, twist)]
    before, after = model.follow(load_object("cylinder"), poses, 5.0)
    assert_equilibrium(after)
    assert after.slip_m.max() == 0.0
    turned = torque(after, model.mesh) - torque(before, model.mesh)
    return force(after) - force(before), turned


def shear_modulus(prestretch):
    """μh = γ0/(1 − λ⁻⁶), N/m."""
    return 100.0 / (1.0 - prestretch**-6)


@pytest.mark.parametrize("prestretch", [1.1, 1.5])
def test_twist_of_a_stuck_disc_equals_the_annulus_solution(prestretch):
    """T = 4π μh θ a²b²/(b² − a²).

    Circles that turn by θ(r) shear the stretched sheet by γ = r θ′, which leaves det C as it is and
    adds γ² to tr C: the energy is (μh/2) ∫ γ² dA over the stress-free sheet stretched evenly, which
    is as large as over the stretched one. Its torque 2π μh r³ θ′ is the same for every circle.
    """
    twist = np.radians(0.1)
    exact = 4 * np.pi * shear_modulus(prestretch) * twist * (INNER * OUTER) ** 2
    exact /= OUTER**2 - INNER**2
    errors = []
    for sectors, rings in ((24, 8), (48, 16)):
        model = flat_sheet(sectors, rings, prestretch)
        errors.append(moved_by_a_disc(model, 0.0, twist)[1] / exact - 1.0)
    assert abs(errors[1]) < 0.012
    assert abs(errors[1]) < 0.3 * abs(errors[0])


def annulus_stiffness(prestretch):
    """Force over motion of a stuck disc in a flat sheet, N/m.

    In second order the energy is ½ ∫ μh |∇u|² + 3 μh λ⁻⁶ (div u)²; with u_r = f cos φ and
    u_φ = −g sin φ it is least for f and g from 1 at the disc to 0 at the rim, found here on lines.
    """
    r = np.geomspace(INNER, OUTER, 401)
    h, middle = np.diff(r), 0.5 * (r[1:] + r[:-1])
    n = len(r)
    slope, mean = np.zeros((n - 1, n)), np.zeros((n - 1, n))
    k = np.arange(n - 1)
    slope[k, k], slope[k, k + 1] = -1 / h, 1 / h
    mean[k, k] = mean[k, k + 1] = 0.5
    none = np.zeros_like(mean)
    over = mean / middle[:, None]
    weight = np.pi * shear_modulus(prestretch) * middle * h
    terms = [
        (1.0, np.hstack([slope, none])),
        (1.0, np.hstack([none, slope])),
        (2.0, np.hstack([over, -over])),
        (3.0 * prestretch**-6, np.hstack([slope + over, -over])),
    ]
    K = sum(c * t.T @ (weight[:, None] * t) for c, t in terms)
    fixed, free = np.array([0, n]), np.r_[1 : n - 1, n + 1 : 2 * n - 1]
    u = np.zeros(2 * n)
    u[fixed] = 1.0
    u[free] = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, fixed)] @ u[fixed])
    return u @ K @ u


@pytest.mark.parametrize("prestretch", [1.1, 1.5])
def test_drag_of_a_stuck_disc_equals_the_annulus_solution(prestretch):
    way = 1e-5
    pulled, _ = moved_by_a_disc(flat_sheet(48, 16, prestretch), way, 0.0)
    assert pulled[0] == pytest.approx(way * annulus_stiffness(prestretch), rel=0.01)
    assert abs(pulled[1]) < 0.01 * pulled[0]


# -- a pressed dome -----------------------------------------------------------------------------


@pytest.mark.long
def test_a_plate_that_sticks_to_a_pressed_dome_twists_its_free_part():
    """T = 2π μh θ / ∫ ds/(r₀ r²) over the free meridian of the exact press without friction."""
    depth, twist = 0.006, np.radians(1.0)
    axial = AxialRubber.dome(A, H, 1.2, GAUGE)
    exact = axial.press(depth)
    line, sphere = exact.meridian, (A**2 + H**2) / (2 * H)
    free = line.r_m >= exact.contact_radius_m - 1e-9
    s, r = line.s_m[free], line.r_m[free]
    compliance = np.trapezoid(1.0 / (sphere * np.sin(s / sphere) * r**2), s)
    wanted = 2 * np.pi * axial.mu_h_n_per_m * twist / compliance
    membrane, gas = dome(1200)  # 300: 15 %, 2500: 2 %
    start = RubberForward(membrane, gas).press(plate(), pose(z=H - depth))
    model = RubberForward(membrane, gas)
    small, *_ = model.follow(plate(), [pose(z=H - depth, twist=0.0)], 5.0, start)
    np.testing.assert_allclose(small.displacement_3d_m, start.displacement_3d_m, atol=1e-9)
    _, turned = model.follow(
        plate(), [pose(z=H - depth), pose(z=H - depth, twist=twist)], 5.0, start
    )
    assert_equilibrium(turned)
    assert torque(turned, model.mesh) == pytest.approx(wanted, rel=0.05)
    assert force(turned)[2] == pytest.approx(force(start)[2], rel=2e-3)


def test_without_friction_the_press_does_not_change():
    membrane, gas = dome(300)
    poses = [pose(0.003, 0.0, H - depth) for depth in (0.002, 0.004, 0.006)]
    free = RubberForward(membrane, gas).press(study_object("puck"), poses[-1])
    *_, slippery = RubberForward(membrane, gas).follow(study_object("puck"), poses, 1e-4)
    assert_equilibrium(slippery)
    difference = slippery.displacement_3d_m - free.displacement_3d_m
    assert np.abs(difference).max() < 1e-6
    np.testing.assert_allclose(force(slippery), force(free), atol=1e-3 * -force(free)[2])


def test_sliding_plate_has_tangential_force_mu_times_load():
    """All nodes slip: |t| = μ f_n at each, and the sum opposes the motion."""
    membrane, gas = dome(300)
    friction = 0.2
    poses = [pose(z=H - 0.005), *(pose(1e-3 * k, 0.0, H - 0.005) for k in range(1, 9))]
    *_, contact = RubberForward(membrane, gas).follow(plate(), poses, friction)
    assert_equilibrium(contact)
    pushed = -contact.nodal_force_n[:, 2]
    touching = pushed > 0.0
    slip = contact.slip_m[touching]  # the plate moved by 1 mm since the contact before
    assert np.median(slip) == pytest.approx(1e-3, rel=0.05) and slip.min() > 5e-4
    np.testing.assert_allclose(across(contact)[touching], friction * pushed[touching], rtol=1e-5)
    fx, fy, fz = force(contact)
    assert fx == pytest.approx(-friction * fz, rel=0.01)
    assert abs(fy) < 0.02 * fx
    assert contact.dissipated_j == pytest.approx(fx * np.median(slip), rel=0.02)


def test_sticking_and_slipping_takes_few_factorisations():
    """Newton's method with the exact derivative of friction: 75; another one takes 110."""
    membrane, gas = dome(300)
    pressed, turned = pose(z=H - 0.005), pose(1e-3, 0.0, H - 0.005, np.radians(3.0))
    poses = [pressed, turned, pose(3e-3, 0.0, H - 0.006, np.radians(9.0))]
    contacts = list(RubberForward(membrane, gas).follow(study_object("puck"), poses, 0.5))
    for contact in contacts:
        assert_equilibrium(contact)
    assert sum(contact.iterations for contact in contacts) < 90


def test_sticking_object_moves_the_membrane():
    """Nodes that touched before move as the object does, while |t| ≤ μ f_n at all of them."""
    membrane, gas = dome(300)
    model = RubberForward(membrane, gas)
    before, after = (pose(z=H - 0.005), pose(1e-3, 0.0, H - 0.005, np.radians(3.0)))
    pressed, moved = model.follow(study_object("puck"), [before, after], 5.0)
    assert_equilibrium(moved)
    assert moved.dissipated_j < 0.05 * -force(pressed)[2] * 1e-3
    held = (pressed.contact_pressure_pa > 0.0) & (moved.contact_pressure_pa > 0.0)
    held &= moved.slip_m == 0.0
    held &= np.hypot(*model.mesh.deformed(pressed.displacement_3d_m)[:, :2].T) < 0.008  # flat there
    assert held.sum() >= 7
    at_first = model.mesh.deformed(pressed.displacement_3d_m)[held]
    carried = (at_first - before[:3, 3]) @ (after @ np.linalg.inv(before))[:3, :3].T + after[:3, 3]
    np.testing.assert_allclose(
        model.mesh.deformed(moved.displacement_3d_m)[held], carried, atol=1e-8
    )


@pytest.mark.long
@pytest.mark.parametrize(("friction", "lost"), [(5.0, (-0.01, 0.15)), (0.4, (0.2, 0.9))])
def test_work_of_the_object_is_stored_or_lost_to_slip(friction, lost):
    membrane, gas = dome(250)
    model = RubberForward(membrane, gas)
    z = H - 0.005
    poses = [
        pose(z=z),
        *(pose(1e-4 * k, 0.0, z) for k in range(1, 26)),
        *(pose(2.5e-3, 0.0, z, np.radians(k)) for k in range(1, 13)),
    ]
    contacts = list(model.follow(study_object("puck"), poses, friction))
    for contact in contacts:
        assert_equilibrium(contact)
    work = 0.0
    for k in range(1, len(poses)):
        way = poses[k][0, 3] - poses[k - 1][0, 3]
        turn = np.arctan2(poses[k][1, 0], poses[k][0, 0]) - np.arctan2(
            poses[k - 1][1, 0], poses[k - 1][0, 0]
        )
        one, two = contacts[k - 1], contacts[k]
        work += 0.5 * way * (force(one) + force(two))[0]
        about = poses[k][0, 3]
        work += 0.5 * turn * (torque(one, model.mesh, about) + torque(two, model.mesh, about))
    stored = contacts[-1].energy_j - contacts[0].energy_j
    slipped = sum(contact.dissipated_j for contact in contacts[1:])
    assert stored + slipped == pytest.approx(work, rel=0.02)
    assert lost[0] < slipped / work < lost[1]


def test_a_twisted_puck_slips_at_its_outer_ring_first():
    membrane, gas = dome(600)
    model = RubberForward(membrane, gas)
    depth = H - 0.004
    *_, contact = model.follow(
        study_object("puck"), [pose(z=depth), pose(z=depth, twist=np.radians(3.0))], 0.5
    )
    assert_equilibrium(contact)
    radius = np.hypot(*model.mesh.deformed(contact.displacement_3d_m)[:, :2].T)
    touching = contact.contact_pressure_pa > 0.0
    slips = contact.slip_m > 1e-6
    stuck = touching & ~slips
    assert slips.sum() >= 5 and stuck.sum() >= 5
    assert radius[slips].min() > np.median(radius[stuck])
    assert radius[slips].mean() > 1.2 * radius[stuck].mean()


@pytest.mark.long
def test_shorter_steps_and_finer_meshes_change_little():
    """A ball dragged in partial slip: halved steps 2 %, a mesh four times as fine 5 %."""
    way = 1.5e-3

    def dragged(nodes, frames):
        membrane, gas = dome(nodes)
        poses = [pose(z=H - 0.006), *(pose(x, 0.0, H - 0.006) for x in np.linspace(0, way, frames))]
        *_, contact = RubberForward(membrane, gas).follow(load_object("sphere"), poses, 0.5)
        assert_equilibrium(contact)
        return force(contact)[[0, 2]]

    coarse, fine = dragged(300, 3), dragged(1200, 3)
    np.testing.assert_allclose(dragged(300, 8), coarse, rtol=0.02)
    np.testing.assert_allclose(fine, coarse, rtol=0.05)
