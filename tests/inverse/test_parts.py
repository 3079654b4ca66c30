"""Pieces of the inverse problem against independent answers."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls

from bubbleviz.inverse import (
    ConstantTension,
    ContactProblem,
    GaussNewton,
    Measurements,
    Nuisances,
    Prior,
    Selection,
    area_above,
    nonnegative_qp,
)
from bubbleviz.membrane import Gas, MembraneMesh, build_mesh, cotangent_laplacian
from tests.inverse.conftest import SENSOR, TENSION, estimator
from tests.oracles.interior_point import interior_point

MESH = build_mesh(SENSOR, 200)


@given(st.integers(1, 40), st.integers(0, 10_000), st.booleans())
@settings(max_examples=60)
def test_pivoting_equals_lawson_hanson(n, seed, warm):
    rng = np.random.default_rng(seed)
    B, b = rng.standard_normal((n + 5, n)), rng.standard_normal(n + 5)
    start = rng.random(n) < 0.5 if warm else np.zeros(n, bool)
    x, _, converged = nonnegative_qp(B.T @ B, -B.T @ b, start)
    assert converged
    assert x == pytest.approx(nnls(B, b)[0], abs=1e-7)


def test_pivoting_terminates_where_full_exchanges_cycle():
    """Nearly singular and badly scaled: terminates by Murty's rule, last index first."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        A, scale = rng.standard_normal((6, 12)), 10.0 ** rng.uniform(-1.0, 1.0, 12)
        H = (A.T @ A + 1e-6 * np.eye(12)) * np.outer(scale, scale)
        f, start = rng.standard_normal(12), rng.random(12) < 0.5
        x, pivots, converged = nonnegative_qp(H, f, start, limit=1000)
        assert converged and pivots < 1000 and x.min() >= 0.0
        slope = H @ x + f
        assert slope.min() > -1e-6 * np.abs(f).max()
        assert np.abs(slope[x > 0.0]).max(initial=0.0) < 1e-6 * np.abs(f).max()


def test_a_deconvolution_takes_few_pivots():
    """All violated indices at a time, as long as that helps: one at a time takes hundreds."""
    place = np.arange(300)
    kernel = np.exp(-0.5 * ((place[:, None] - place) / 2.0) ** 2)
    truth = 1.0 * ((place >= 50) & (place < 80)) + 2.0 * ((place >= 200) & (place < 210))
    H = kernel @ kernel + 1e-2 * np.eye(300)
    for seed in range(3):
        noise = 0.05 * np.random.default_rng(seed).standard_normal(300)
        f = -kernel @ (kernel @ truth + noise)
        x, pivots, converged = nonnegative_qp(H, f, np.zeros(300, bool))
        assert converged and pivots <= 20
        assert nonnegative_qp(H, f, x > 0.0)[1] == 1


def test_pivoting_reports_an_indefinite_matrix():
    x, _, converged = nonnegative_qp(-np.eye(3), -np.ones(3), np.ones(3, bool))
    assert not converged
    assert not x.any()


@pytest.mark.parametrize("chamber", [1e-7, 2e-3, 10.0])
@pytest.mark.parametrize("gas_pa", [None, 150.0])
def test_motion_adjoint_and_responses_of_constant_tension(chamber, gas_pa):
    """γ0 L u = A (p_v − p_c) with p_v = −βᵀu or as measured, and its adjoint."""
    pneumatics = SENSOR.pneumatics.model_copy(update={"chamber_volume_m3": chamber})
    gas, rng = Gas.of(pneumatics, MESH), np.random.default_rng(1)
    film = ConstantTension(MESH, TENSION, gas)
    p = np.where(MESH.rim, 0.0, 1e3 * rng.random(len(MESH.nodes)))
    force = rng.standard_normal(MESH.nodes.shape)
    tangent = film.linearised(MESH.nodes, p, gas_pa)
    push = (gas_pa or 0.0) - p
    motion = tangent.motion(push[:, None] * tangent.area_vectors)
    u = np.einsum("ij,ij->i", motion, MESH.normals)
    assert motion == pytest.approx(u[:, None] * MESH.normals, abs=1e-12)
    p_v = -gas.beta @ u if gas_pa is None else gas_pa
    load, free = MESH.areas * (p_v - p), MESH.free
    stiffness = TENSION * cotangent_laplacian(MESH)
    assert (stiffness @ u)[free] == pytest.approx(load[free], abs=1e-6 * np.abs(load).max())
    assert not u[MESH.rim].any()
    assert tangent.adjoint(force) @ push == pytest.approx(np.vdot(force, motion), rel=1e-6)
    moved = tangent.responses(free) @ push[free]
    assert moved == pytest.approx(motion.ravel(), rel=1e-5, abs=1e-12)


def test_equilibrium_of_constant_tension_has_the_exact_gas_law():
    """From the linear one, where a dent of a tenth of the gas's volume makes 10 % of difference."""
    gas = Gas.of(SENSOR.pneumatics.model_copy(update={"chamber_volume_m3": 1e-3}), MESH)
    film = ConstantTension(MESH, TENSION, gas)
    p = np.where(MESH.nodes[:, 2] > 0.035, 1.2e4, 0.0)
    tangent = film.linearised(MESH.nodes, p, None)
    start = MESH.nodes - tangent.motion(p[:, None] * tangent.area_vectors)
    x, balanced, _ = film.equilibrium(tangent, start, p, None)
    u = np.einsum("ij,ij->i", x - MESH.nodes, MESH.normals)
    p_v = gas.pressure_change(u)
    assert balanced and abs(p_v + gas.beta @ u) > 0.05 * p_v
    missed = TENSION * (cotangent_laplacian(MESH) @ u) - MESH.areas * (p_v - p)
    assert np.abs(missed[MESH.free]).max() < 1e-3 * film.held_pressure_pa * MESH.areas.mean()


@pytest.fixture(scope="module")
def problem_of(sphere):
    """Noisy press on a coarse mesh, linearised at rest: problem, the oracle's form of it, and τ."""
    solver, depth = estimator(300), sphere.depth(0.01)
    mesh, film, nothing = solver.mesh, solver.bubble, np.zeros(len(solver.mesh.nodes))
    newton = GaussNewton(solver.observer, film, solver.prior_weight, 0.1, 0.0, 0.0)
    view, observation = solver.observer.around(mesh.nodes), solver.observer.observe(depth)
    error, weight = observation.residual_m[view.block], observation.weight[view.block]
    ranges = Measurements(view.jacobian, error, weight, Nuisances.none(len(nothing)))
    tau = newton.threshold(ranges)

    def of(gas_pa):
        tangent = film.linearised(mesh.nodes, nothing, gas_pa)
        prior, bulge = Prior(solver.smoothness, tau, mesh.rings), (gas_pa or 0.0) * tangent.bulge
        problem = ContactProblem(tangent, ranges, prior, nothing, bulge)

        def exact(threshold, allowed):
            return interior_point(film, ranges, solver.smoothness, threshold, allowed, gas_pa)

        return mesh, problem, exact, tau

    return of


@pytest.mark.parametrize("gas_pa", [None, 300.0])
def test_an_interior_point_certifies_support_and_pressure(problem_of, gas_pa):
    mesh, problem, exact, tau = problem_of(gas_pa)
    nothing = np.zeros(len(tau))
    found = problem.select(nothing > 0.0, 20)
    assert found.converged and found.complete
    with_l1 = exact(tau, ~mesh.rim)
    np.testing.assert_array_equal(found.support, with_l1 > 1e-6 * with_l1.max())
    assert 5 < np.count_nonzero(found.support) < 50
    contact = problem.solve_debiased(found, lambda support, _: support)
    debiased = exact(nothing, found.support)
    assert contact.pressure == pytest.approx(debiased, abs=1e-6 * debiased.max())
    assert debiased.sum() > with_l1.sum()  # the L1 term takes a part of the force
    assert problem.kkt_residual(contact.pressure) < 1e-9


def test_the_residual_measures_the_kkt_conditions(problem_of):
    """min(p_c, ∇) under pressure, both in units of their largest; ∇ by differences of responses."""
    _, problem, _, tau = problem_of(None)
    nothing = np.zeros(len(tau))
    found = problem.select(nothing > 0.0, 20)
    pressure = problem.solve_debiased(found, lambda support, _: support).pressure
    at_zero = np.abs(problem.gradient(nothing)).max()
    for share in (1.01, 0.9, 2.0):  # ∇ is linear, and 0 at the solution
        slope = (1.0 - share) * problem.gradient(nothing)[pressure > 0.0] / at_zero
        missed = np.abs(np.minimum(pressure[pressure > 0.0] / pressure.max(), slope)).max()
        assert problem.kkt_residual(share * pressure) == pytest.approx(missed, rel=1e-6)
    assert problem.kkt_residual(nothing) == 0.0


def test_another_prior_and_noise_are_those_of_a_problem_made_with_them(sphere):
    """Though products with the response are kept, and nodes may be added after the change."""
    solver, depth = estimator(300), sphere.depth(0.01)
    mesh, film, nothing = solver.mesh, solver.bubble, np.zeros(len(solver.mesh.nodes))
    view, observation = solver.observer.around(mesh.nodes), solver.observer.observe(depth)
    error, weight = observation.residual_m[view.block], observation.weight[view.block]
    errors = np.stack([np.ones_like(error), error.mean() * np.sin(np.arange(len(error)))], axis=1)
    tangent, near = film.linearised(mesh.nodes, nothing, None), mesh.nodes[:, 2] > 0.03

    def problem(mean, root, factor):
        nuisances = Nuisances(*2 * [np.zeros((len(nothing), 3, 0))], errors, mean, root)
        ranges = Measurements(view.jacobian, error, factor * weight, nuisances)
        prior = Prior(solver.smoothness, nothing, mesh.rings)
        return ContactProblem(tangent, ranges, prior, nothing, np.zeros_like(mesh.nodes))

    def contact(of, support):
        return of.solve_debiased(Selection(support), lambda support, _: support)

    mean, root = np.array([1e-3, 0.5]), np.array([[2e-4, 0.0], [0.1, 0.3]])
    changed = contact(problem(np.zeros(2), np.diag([1e-3, 0.2]), 1.0), near).problem
    changed = changed.with_prior(np.ones(2), 0.1 * root, 0.3).with_prior(mean, root, 0.5)
    for support in (near, mesh.nodes[:, 2] > 0.02):
        found, expected = contact(changed, support), contact(problem(mean, root, 0.15), support)
        assert expected.pressure.any() and np.abs(expected.amplitudes - mean).max() > 1e-5
        scale = expected.pressure.max()
        np.testing.assert_allclose(found.pressure, expected.pressure, rtol=0, atol=1e-8 * scale)
        np.testing.assert_allclose(found.amplitudes, expected.amplitudes, rtol=1e-7)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6, atol=1e-15)


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3), st.floats(0.01, 0.99))
def test_area_above_a_level_of_one_triangle(values, level):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    mesh = MembraneMesh(corners, np.array([[0, 1, 2]]), np.ones(3, bool))
    u, v = np.meshgrid(*2 * [(np.arange(800) + 0.5) / 800])
    inside = u + v < 1
    field = values[0] + (values[1] - values[0]) * u + (values[2] - values[0]) * v
    expected = np.count_nonzero((field > level) & inside) / 800**2
    assert area_above(mesh, np.array(values), level) == pytest.approx(expected, abs=3e-3)
