"""Forward contact against other solvers, exact solutions and conservation."""

import clarabel
import numpy as np
import pytest
from domes import plate, pose as posed
from scipy import sparse
from scipy.optimize import brentq

from bubbleviz.membrane import (
    ForwardModel,
    GapFinder,
    Gas,
    MembraneMesh,
    ObstacleSolver,
    cotangent_laplacian,
    mesh_cap,
    spherical_cap,
)
from bubbleviz.rigid_object import RigidObject, load_object
from bubbleviz.sensor import load_sensor

A, H = 0.075, 0.050
TENSION = 105.0


@pytest.fixture(scope="module")
def mesh():
    return mesh_cap(spherical_cap(A, H), 800)


def gas_of(mesh, *, chamber=2.2e-3, model="exact", gauge=2585.5):
    pneumatics = load_sensor("pico_flexx_75mm").pneumatics.model_copy(
        update={"chamber_volume_m3": chamber, "volume_model": model, "gauge_pressure_pa": gauge}
    )
    return Gas.of(pneumatics, mesh)


def at(x=0.0, y=0.0, z=H):
    return posed(x, y, z)


def assert_equilibrium(contact):
    assert contact.converged
    assert contact.complementarity < 1e-9
    assert contact.penetration_m < 1e-12
    assert contact.balance_residual < 1e-9
    assert contact.gas_law_residual < 1e-9
    assert contact.contact_pressure_pa.min() >= 0.0


# -- the bound from the object ------------------------------------------------------------------


def test_gap_to_a_ball_equals_the_line_sphere_distance(mesh):
    pose = at(0.01, -0.005, H - 0.004)
    gap = GapFinder(mesh).gaps(load_object("sphere"), pose)
    centre = pose[:3, 3] + [0.0, 0.0, 0.015]
    offset = mesh.nodes - centre
    b = np.einsum("ij,ij->i", offset, mesh.normals)
    discriminant = b**2 - (np.einsum("ij,ij->i", offset, offset) - 0.015**2)
    exact = np.where(discriminant > 0, -b - np.sqrt(np.maximum(discriminant, 0)), np.inf)
    clear = np.abs(discriminant) > 2e-6  # grazing lines differ between sphere and facets
    np.testing.assert_array_equal(np.isfinite(gap[clear]), np.isfinite(exact[clear]))
    both = clear & np.isfinite(exact)
    assert both.sum() >= 15
    assert (exact[both] < 0).any()
    assert (exact[both] > 0).any()
    slant = np.sqrt(discriminant[both]) / 0.015  # facets lie 0.01 mm inside the sphere
    assert (np.abs(gap[both] - exact[both]) * slant).max() < 1.5e-5


def test_gap_takes_the_lowest_part_of_a_thin_object(mesh):
    """A plate pressed past the nodes: they belong below it, not between it and the dome."""
    finder = GapFinder(mesh)
    top = int(mesh.nodes[:, 2].argmax())
    assert finder.gaps(plate(thickness=0.002), at(z=H - 0.01))[top] == pytest.approx(
        -0.01, rel=1e-4
    )
    sheet = RigidObject("sheet", plate().vertices[:4], plate().triangles[:2])  # no inside
    turned = RigidObject("sheet", sheet.vertices, sheet.triangles[:, [0, 2, 1]])
    for obj in (sheet, turned):
        assert finder.gaps(obj, at(z=H - 0.01))[top] == pytest.approx(-0.01, rel=1e-4)


@pytest.mark.parametrize("name", ["hex_nut", "torus"])
def test_object_with_inward_normals_gives_the_same_bounds(mesh, name):
    obj, finder = load_object(name), GapFinder(mesh)
    turned = RigidObject(name, obj.vertices, obj.triangles[:, ::-1])
    same = finder.gaps(turned, at(z=H - 0.004))
    assert np.isfinite(same).any()
    np.testing.assert_allclose(same, finder.gaps(obj, at(z=H - 0.004)), atol=1e-12)


def test_an_object_at_the_opposite_side_of_a_tall_dome_bounds_only_that_side():
    tall = mesh_cap(spherical_cap(A, 1.6 * A), 800)
    radius = (1 + 1.6**2) / 3.2 * A
    ball = load_object("sphere")
    pose = at(radius - 0.005, 0.0, 1.6 * A - radius)
    pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # tip to −x: pressed into the +x side
    gap = GapFinder(tall).gaps(ball, pose)
    assert np.isfinite(gap[tall.nodes[:, 0] > 0.9 * radius]).any()
    assert not np.isfinite(gap[tall.nodes[:, 0] < 0.0]).any()


def test_gap_search_reaches_halfway_through_the_chamber():
    """Of a sphere's cap: halfway to the rim's cylinder, or a rim radius behind the rim."""
    radius, height = 0.05, 0.045
    cap = mesh_cap(spherical_cap(radius, height), 800)
    across = np.hypot(*cap.nodes[:, :2].T)
    ball = (radius**2 + height**2) / (2.0 * height)
    sine = across / ball  # of the normal's angle to the axis; no line meets the cap again
    cosine = np.sqrt(1.0 - sine**2)
    with np.errstate(divide="ignore"):
        side, down = (across + radius) / (2.0 * sine), (cap.nodes[:, 2] + radius) / cosine
    inside = ~cap.rim
    found = GapFinder(cap).reach
    np.testing.assert_allclose(found[inside], np.minimum(side, down)[inside], rtol=0.03)
    assert (side < down)[inside].any() and (down < side)[inside].any()


# -- the obstacle problem -----------------------------------------------------------------------


def test_a_ball_above_the_membrane_leaves_it_at_rest_and_one_a_little_lower_does_not(mesh):
    model, top = ForwardModel(mesh, TENSION, gas_of(mesh)), float(mesh.nodes[:, 2].max())
    above, below = (model.press(load_object("sphere"), at(z=top + dz)) for dz in (1e-5, -1e-4))
    assert_equilibrium(above)
    assert np.abs(above.displacement_m).max() < 1e-12
    assert above.contact_pressure_pa.max() == 0.0
    assert_equilibrium(below)
    assert below.contact_pressure_pa.max() > 0.0


@pytest.mark.parametrize("name", ["frustum", "two_legged_toy", "torus", "two_spheres", "hex_nut"])
def test_same_minimiser_as_an_interior_point_solver(mesh, name):
    contact = ForwardModel(mesh, TENSION, gas_of(mesh)).press(load_object(name), at(0.004, 0, 0.04))
    assert_equilibrium(contact)
    free = mesh.free
    K = (TENSION * cotangent_laplacian(mesh))[free][:, free]
    gap = contact.gap_m[free]
    bounded = np.flatnonzero(np.isfinite(gap))
    selector = sparse.eye_array(len(free), format="csr")[bounded]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(K)),
        -contact.gas_pressure_change_pa * mesh.areas[free],
        sparse.csc_matrix(selector),
        gap[bounded],
        [clarabel.NonnegativeConeT(len(bounded))],
        settings,
    ).solve()
    u = np.array(solution.x)
    p_c = np.zeros(len(free))
    p_c[bounded] = np.array(solution.z) / mesh.areas[free][bounded]
    np.testing.assert_allclose(contact.displacement_m[free], u, atol=1e-8)
    assert np.abs(contact.contact_pressure_pa[free] - p_c).max() < 1e-4 * p_c.max()


def test_exact_contact_of_the_linear_model_on_a_flat_disc():
    """A disc bulged by p against a plate at gap g touches it within the radius c:
    g = p/(4 γ0) [a² − c² − 2 c² ln(a/c)], force p π c², volume by quadrature."""
    cap = mesh_cap(spherical_cap(A, 0.02 * A), 6000)
    disc = MembraneMesh(cap.nodes * [1, 1, 0], cap.triangles, cap.rim)
    gap, pressure = 0.002, 600.0

    def shape(r, c):  # γ0 (u'' + u'/r) = −p outside c, with u'(c) = 0 and u(a) = 0
        quarter = 0.25 * pressure / TENSION
        return quarter * (A**2 - r**2) + 2.0 * quarter * c**2 * np.log(r / A)

    c = brentq(lambda c: shape(c, c) - gap, 1e-6, 0.999 * A)
    assert 0.3 * A < c < 0.9 * A
    free = disc.free
    solver = ObstacleSolver(
        cotangent_laplacian(disc)[free][:, free], disc.areas[free], disc.areas[free]
    )
    state = solver.solve(np.full(len(free), gap), lambda *_: pressure / TENSION)
    assert state.converged
    r = np.hypot(*disc.nodes[free, :2].T)
    exact = np.where(r < c, gap, shape(np.maximum(r, c), c))
    assert np.abs(state.displacement - exact).max() < 4e-3 * gap
    assert TENSION * state.reaction.sum() == pytest.approx(pressure * np.pi * c**2, rel=0.01)
    rs = np.linspace(c, A, 20001)
    volume = np.pi * c**2 * gap + np.trapezoid(2.0 * np.pi * rs * shape(rs, c), rs)
    assert disc.areas[free] @ state.displacement == pytest.approx(volume, rel=3e-3)


def test_force_balance_and_signs(mesh):
    """Force on the object: force of the gas minus force of the rim."""
    contact = ForwardModel(mesh, TENSION, gas_of(mesh)).press(load_object("frustum"), at(z=0.035))
    assert_equilibrium(contact)
    assert contact.gas_pressure_change_pa > 0.0
    K = TENSION * cotangent_laplacian(mesh)
    free = mesh.free
    elastic = (K @ contact.displacement_m)[free].sum()
    gas = contact.gas_pressure_change_pa * mesh.areas[free].sum()
    load = (mesh.areas * contact.contact_pressure_pa)[free].sum()
    assert load == pytest.approx(gas - elastic, rel=1e-9)
    touched = contact.contact_pressure_pa > 0
    assert contact.displacement_m[touched].max() < 0.0
    assert contact.displacement_m.max() > 0.0  # the rest bulges out
    assert contact.displacement_m[mesh.rim].tolist() == [0.0] * int(mesh.rim.sum())
    # the gas law on the membrane's own volume, not on what the solver says
    volume = gas_of(mesh).V0 + mesh.areas @ contact.displacement_m
    p = 103910.5 * gas_of(mesh).V0 / volume - 103910.5
    assert contact.gas_pressure_change_pa == pytest.approx(p, rel=1e-9)


# -- the gas law --------------------------------------------------------------------------------


@pytest.mark.parametrize("chamber", [1e-7, 2.2e-3, 10.0])
@pytest.mark.parametrize("tension", [1e-3, 105.0, 1e6])
def test_the_gas_law_holds_at_every_stiffness(mesh, tension, chamber):
    """Root of P0 V0 − (P0 + p) V(u(p)) by bracketing, each u at a fixed pressure."""
    gas = gas_of(mesh, chamber=chamber)
    joint = ForwardModel(mesh, tension, gas).press(load_object("torus"), at(z=0.038))
    assert_equilibrium(joint)
    free, areas = mesh.free, mesh.areas[mesh.free]
    solver = ObstacleSolver(cotangent_laplacian(mesh)[free][:, free], areas, areas)

    def shape(pressure):
        state = solver.solve(joint.gap_m[free], lambda *_: pressure / tension, max_iterations=2000)
        assert state.converged
        return state.displacement

    def excess(pressure):
        return gas.P0 * gas.V0 - (gas.P0 + pressure) * (gas.V0 + areas @ shape(pressure))

    high = 1e-2 * gas.P0
    while excess(high) > 0.0:
        high *= 4.0
    root = brentq(excess, -gas.P0, high, xtol=1e-13 * gas.P0, rtol=1e-14)
    assert root == pytest.approx(joint.gas_pressure_change_pa, rel=1e-5, abs=1e-4)
    np.testing.assert_allclose(shape(root), joint.displacement_m[free], atol=2e-7)


def test_paper_volume_model_reports_a_third_for_a_stiff_chamber(mesh):
    """With u the same (huge chamber), ΔV and so p_v is exactly a third."""
    obj, pose = load_object("torus"), at(z=0.04)
    full, third = (
        ForwardModel(mesh, TENSION, gas_of(mesh, chamber=10.0, model=m)).press(obj, pose)
        for m in ("exact", "paper")
    )
    ratio = full.gas_pressure_change_pa / third.gas_pressure_change_pa
    assert ratio == pytest.approx(3.0, rel=0.01)


# -- hard cases ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("obj", "pose"),
    [
        (plate(), at(z=0.045)),
        (plate(), at(z=0.005)),
        (plate(thickness=1e-3), at(z=0.025)),
        (load_object("sphere"), at(z=0.010)),  # wholly inside the reference surface
        (load_object("cylinder"), at(0.05, 0.02, 0.02)),
        (load_object("frustum"), at(z=0.0499999)),  # grazing
    ],
    ids=["plate", "plate to 90 %", "thin plate", "inside", "off centre", "grazing"],
)
def test_hard_poses_reach_equilibrium(mesh, obj, pose):
    contact = ForwardModel(mesh, TENSION, gas_of(mesh)).press(obj, pose)
    assert_equilibrium(contact)
    assert np.isfinite(contact.displacement_m).all()


def test_sliver_meshes_reach_equilibrium(mesh):
    """Squeezed to angles near 0.5° the Laplacian is no M-matrix and the active set may cycle."""
    squeezed = MembraneMesh(mesh.nodes * [0.008, 1.0, 1.0], mesh.triangles, mesh.rim)
    assert np.degrees(squeezed.angles.min()) < 1.0
    model = ForwardModel(squeezed, TENSION, gas_of(squeezed))
    for depth in (0.002, 0.01, 0.02):
        bound = np.where(np.abs(squeezed.nodes[:, 1]) < 0.02, -depth, np.inf)
        contact = model.solve(bound)
        assert_equilibrium(contact)


@pytest.mark.parametrize("seed", [268, 1165, 1244])
def test_fallback_rule_terminates_where_the_active_set_cycles(seed):
    """Dense positive definite matrices, no M-matrices, on which exchanging all wrong cycles."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 14))
    B = rng.standard_normal((n, n))
    K, areas = B @ B.T + 1e-2 * np.eye(n), np.ones(n)
    bound, p = rng.standard_normal(n), rng.standard_normal()
    active, seen = bound < 0.0, set()
    while active.tobytes() not in seen:
        seen.add(active.tobytes())
        u, rest = bound.copy(), ~active
        pull = areas[rest] * p - K[np.ix_(rest, active)] @ bound[active]
        u[rest] = np.linalg.solve(K[np.ix_(rest, rest)], pull)
        wrong = np.where(active, areas * p - K @ u < 0.0, u > bound)
        active = active ^ wrong
    assert wrong.any()  # the plain rule came back to a set it had
    state = ObstacleSolver(sparse.csr_array(K), areas, areas).solve(bound, lambda *_: p)
    assert state.converged
    assert (state.displacement - bound).max() < 1e-9
    assert state.reaction.min() > -1e-9
    np.testing.assert_allclose(K @ state.displacement + state.reaction, areas * p, atol=1e-8)
    assert np.abs(state.reaction * (state.displacement - bound)).max() < 1e-9


def test_a_press_takes_few_factorisations(mesh):
    """By starting guess, exchanges and secant of the gas: 28 in total."""
    count, model = 0, ForwardModel(mesh, TENSION, gas_of(mesh))
    for name in ("sphere", "torus", "hex_nut", "two_legged_toy", "frustum"):
        for depth in (0.003, 0.01):
            model.forget()
            contact = model.press(load_object(name), at(0.005, 0.0, H - depth))
            assert_equilibrium(contact)
            count += contact.iterations
    assert count < 34


def test_warm_start_changes_iterations_not_the_answer(mesh):
    obj = load_object("two_legged_toy")
    warm = ForwardModel(mesh, TENSION, gas_of(mesh))
    iterations = []
    for z in np.linspace(0.049, 0.035, 29):
        a = warm.press(obj, at(z=z))
        b = ForwardModel(mesh, TENSION, gas_of(mesh)).press(obj, at(z=z))
        np.testing.assert_allclose(a.displacement_m, b.displacement_m, atol=1e-12)
        iterations.append((a.iterations, b.iterations))
    warm_total, cold_total = np.sum(iterations, axis=0)
    assert warm_total < cold_total


def test_gas_behind_a_membrane_that_is_fixed_everywhere(mesh):
    """Nothing gives way: p_v is Boyle's law at the volume that the bound leaves."""
    gas = gas_of(mesh, chamber=1e-4)
    model = ForwardModel(mesh, TENSION, gas)
    contact = model.solve(np.where(mesh.rim, np.inf, -2e-3))
    assert_equilibrium(contact)
    V0 = 1e-4 + mesh.cap_volume()
    V = (
        1e-4
        + MembraneMesh(mesh.deformed(contact.displacement_m), mesh.triangles, mesh.rim).cap_volume()
    )
    assert V < 0.98 * V0
    assert contact.gas_pressure_change_pa == pytest.approx(gas.P0 * (V0 / V - 1.0), rel=0.05)
    # what holds the membrane down is the gas, and the tension that its dent adds
    free = mesh.free
    elastic = TENSION * (cotangent_laplacian(mesh) @ contact.displacement_m)[free]
    held = contact.gas_pressure_change_pa - elastic / mesh.areas[free]
    np.testing.assert_allclose(contact.contact_pressure_pa[free], held, rtol=1e-9)
