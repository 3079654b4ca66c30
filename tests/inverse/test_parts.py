"""Pieces of the inverse problem against independent answers."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import nnls

from bubbleviz.camera import RangeObserver, range_jacobian
from bubbleviz.inverse import (
    Equilibrium,
    NormalEquations,
    ReducedHessian,
    Scales,
    area_above,
    natural_residual,
    nonnegative_qp,
    problem,
)
from bubbleviz.membrane import Gas, MembraneMesh, build_mesh
from tests.inverse.conftest import CAMERA, SENSOR, TENSION

MESH = build_mesh(SENSOR, 200)


@given(st.integers(1, 40), st.integers(0, 10_000), st.booleans())
@settings(max_examples=60)
def test_pivoting_solves_what_lawson_and_hanson_solve(n, seed, warm):
    rng = np.random.default_rng(seed)
    B, b = rng.standard_normal((n + 5, n)), rng.standard_normal(n + 5)
    start = rng.random(n) < 0.5 if warm else np.zeros(n, bool)
    x, _, converged = nonnegative_qp(B.T @ B, -B.T @ b, start)
    assert converged
    assert x == pytest.approx(nnls(B, b)[0], abs=1e-7)


def test_pivoting_ends_where_full_exchanges_go_round_in_circles():
    """Nearly singular and badly scaled: what decides is Murty's rule, last index first."""
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


def test_pivoting_says_where_a_matrix_is_not_definite():
    x, _, converged = nonnegative_qp(-np.eye(3), -np.ones(3), np.ones(3, bool))
    assert not converged
    assert not x.any()


def test_normal_equations_equal_the_sparse_product():
    observer = RangeObserver(CAMERA, MESH, 0.01, block=4)
    rng = np.random.default_rng(0)
    base = np.where(MESH.rim, 0.0, -0.005 * rng.random(len(MESH.nodes)))
    linear = observer.linearise(base)
    depth = CAMERA.depth_image(rng.uniform(0.14, 0.16, (171, 224))).astype(np.float32)
    depth[rng.random(depth.shape) < 0.5] = np.nan
    seen = observer.observe(depth)
    Q, g = NormalEquations(MESH).assemble(seen, linear)
    D = range_jacobian(linear.hits, MESH.triangles, len(MESH.nodes))[:, MESH.free]
    W = seen.weight[linear.hits.ray]
    e = seen.residual_m[linear.hits.ray] - linear.offset_m
    expected = (D.T * W) @ D
    assert Q.toarray() == pytest.approx(expected.toarray(), rel=1e-9, abs=1e-9 * expected.max())
    assert g == pytest.approx(D.T @ (W * e), rel=1e-9, abs=1e-9 * np.max(np.abs(g)))


@pytest.mark.parametrize("chamber", [1e-7, 2e-3, 10.0])
def test_equilibrium_and_its_adjoint(chamber):
    pneumatics = SENSOR.pneumatics.model_copy(update={"chamber_volume_m3": chamber})
    eq = Equilibrium(MESH, Gas.of(pneumatics, MESH), Scales.of(MESH, TENSION))
    rng = np.random.default_rng(1)
    p, force = rng.random(len(eq.A)), rng.standard_normal(len(eq.A))
    u, gas = eq.displacement(p)
    assert eq.L @ u == pytest.approx(eq.A * (gas - p), abs=1e-10)
    assert gas == pytest.approx(-eq.beta @ u, rel=1e-6)
    every = np.arange(len(eq.A))
    assert eq.response(every) @ p == pytest.approx(-u, rel=1e-5, abs=1e-12)
    assert eq.adjoint(force, gas_measured=False) @ p == pytest.approx(-force @ u, rel=1e-6)
    fixed, _ = eq.displacement(p, 0.0)
    assert eq.adjoint(force, gas_measured=True) @ p == pytest.approx(-force @ fixed, rel=1e-6)


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3), st.floats(0.01, 0.99))
def test_area_above_a_level_of_one_triangle(values, level):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    mesh = MembraneMesh(corners, np.array([[0, 1, 2]]), np.ones(3, bool))
    u, v = np.meshgrid(*2 * [(np.arange(800) + 0.5) / 800])
    inside = u + v < 1
    field = values[0] + (values[1] - values[0]) * u + (values[2] - values[0]) * v
    expected = np.count_nonzero((field > level) & inside) / 800**2
    assert area_above(mesh, np.array(values), level) == pytest.approx(expected, abs=3e-3)


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("limit", [3_000, 10])
def test_model_hessian_is_the_definition(monkeypatch, measured, limit):
    """Formed whole, or where it is asked for on a mesh of more nodes than the limit."""
    monkeypatch.setattr(problem, "DENSE_LIMIT", limit)
    eq = Equilibrium(MESH, Gas.of(SENSOR.pneumatics, MESH), Scales.of(MESH, TENSION))
    observer = RangeObserver(CAMERA, MESH, 0.01, block=4)
    Q, _ = NormalEquations(MESH).assemble(observer.observe_everything(), observer.linearise())
    Q = Q * Scales.of(MESH, TENSION).length_m ** 2
    M = eq.response(np.arange(len(eq.A)), measured)
    exact = M.T @ (Q @ M) + 0.1 * eq.L.toarray()
    hessian, rng = ReducedHessian(eq, Q, 0.1), np.random.default_rng(0)
    for size in (3, 80, len(eq.A)):
        nodes = rng.permutation(len(eq.A))[:size]
        block = hessian.block(nodes, measured, 2.0)
        expected = 2.0 * exact[np.ix_(nodes, nodes)]
        assert block == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_the_residual_is_what_the_conditions_of_optimality_miss_by():
    """min(p_c, ∇) where contact is allowed, both in units of their largest."""
    areas = np.array([1.0, 2.0, 0.5, 1.0])
    allowed = np.array([True, True, True, False])
    problem = SimpleNamespace(allowed=allowed, gradient_scale=lambda areas: 4.0)
    for unit in (1e-3, 1.0, 1e3):
        pressure = unit * np.array([2.0, 0.5, 0.0, 9.0])
        for gradient, missed in (
            ([0.0, 0.0, 0.0, -9.0], 0.0),
            ([0.0, 0.0, 7.0, 0.0], 0.0),
            ([0.4, 0.0, 0.0, 0.0], 0.1),
            ([0.0, 8.0, 0.0, 0.0], 0.5 / 9.0),
            ([0.0, 0.0, -0.4, 0.0], 0.2),
        ):
            found = natural_residual(areas, problem, pressure, np.array(gradient))
            assert found == pytest.approx(missed)
    nothing = natural_residual(areas, problem, np.zeros(4), np.array([0.0, -0.8, 9.0, -9.0]))
    assert nothing == pytest.approx(0.1)
    still = SimpleNamespace(allowed=allowed, gradient_scale=lambda areas: 0.0)
    assert natural_residual(areas, still, np.zeros(4), np.ones(4)) == 0.0
