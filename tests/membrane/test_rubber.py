"""The exact membrane: derivatives, invariances and limits of energy, force and tangent."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bubbleviz.errors import InputError
from bubbleviz.membrane import (
    EllipsoidalCap,
    MembraneMesh,
    RubberMembrane,
    cotangent_laplacian,
    inverse_metric,
    mesh_cap,
    spherical_cap,
)

A, H, GAUGE, TENSION = 0.045, 0.020, 2500.0, 76.0
KINDS = [(1.02, None), (1.3, None), (None, None), (1.2, 1.5e-4)]
"""Prestretch and slack of the rim."""


@pytest.fixture(scope="module")
def mesh():
    return mesh_cap(EllipsoidalCap.of((0.055, 0.040), 0.030), 150)


def moved(mesh, membrane, size, seed):
    """A random vector over the nodes, 0 at fixed ones."""
    vector = size * np.random.default_rng(seed).standard_normal(mesh.nodes.shape)
    vector[np.setdiff1d(np.arange(len(mesh.nodes)), membrane.moving)] = 0.0
    return vector


@pytest.mark.parametrize(("prestretch", "slack"), KINDS)
def test_force_is_the_gradient_of_the_energy(mesh, prestretch, slack):
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, prestretch, slack)
    x = mesh.nodes + moved(mesh, membrane, 1e-3, 0)
    way, h = moved(mesh, membrane, 1.0, 1), 1e-7
    for value, gradient in (
        (membrane.energy, membrane.force(x)),
        (membrane.volume, membrane.volume_gradient(x)),
    ):
        difference = (value(x + h * way) - value(x - h * way)) / (2 * h)
        assert difference == pytest.approx(np.sum(gradient * way), rel=1e-7)


@pytest.mark.parametrize(("prestretch", "slack"), KINDS)
@pytest.mark.parametrize("kind", ["gas", "contact"])
def test_tangent_is_the_derivative_of_the_residual(mesh, prestretch, slack, kind):
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, prestretch, slack)
    pressure = 3e3
    if kind == "contact":  # a pressure of its own at every node
        pressure = np.random.default_rng(2).uniform(-2e4, 4e3, len(mesh.nodes))
    x = mesh.nodes + moved(mesh, membrane, 1e-3, 3)
    K = membrane.tangent(x, pressure)
    h = 1e-7
    for seed in (4, 5):
        way = moved(mesh, membrane, 1.0, seed)
        ahead, behind = (membrane.residual(x + s * h * way, pressure) for s in (1, -1))
        difference = ((ahead - behind) / (2 * h))[membrane.moving].ravel()
        product = K @ way[membrane.moving].ravel()
        assert np.abs(difference - product).max() < 1e-7 * np.abs(product).max()
    if kind == "gas":
        assert abs(K - K.T).max() < 1e-12 * abs(K).max()


@pytest.mark.parametrize("slack", [None, 2e-4])
def test_residuals_of_other_materials_are_each_its_own(mesh, slack):
    own = RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.2, slack)
    others = [
        RubberMembrane.uniform(mesh, gauge, tension, prestretch, slack)
        for gauge, tension, prestretch in ((GAUGE, TENSION, 1.3), (1.1 * GAUGE, 1.2 * TENSION, 1.2))
    ]
    x = mesh.nodes + moved(mesh, own, 1e-3, 3)
    found = own.residual_changes(others, x)
    for k, other in enumerate(others):
        change = other.residual(x, other.gauge_pressure_pa - GAUGE) - own.residual(x, 0.0)
        assert found[..., k] == pytest.approx(change, abs=1e-9 * np.abs(change).max())


@pytest.mark.parametrize("prestretch", [1.1, None])
def test_energy_is_invariant_to_rigid_motion(mesh, prestretch):
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, prestretch)
    x = mesh.nodes + moved(mesh, membrane, 1e-3, 6)
    R = Rotation.from_rotvec([0.4, -0.3, 1.0]).as_matrix()
    turned = x @ R.T + [0.1, 0.0, -0.2]
    # The constant part of the energy is that of the springs, which knows no place either.
    assert membrane.energy(turned) == pytest.approx(membrane.energy(x), rel=1e-12)
    np.testing.assert_allclose(membrane.force(turned), membrane.force(x) @ R.T, atol=1e-12)


def test_energy_and_stress_are_those_of_the_constitutive_law():
    """One triangle stretched λ1, λ2 and turned: W = A₀ μh/2 (λ1² + λ2² + 1/(λ1λ2)² − 3),
    T1 = μh (λ1² − 1/(λ1λ2)²)/(λ1λ2)."""
    flat = np.array([[0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [0.5e-3, 1.5e-3, 0.0]])
    mesh = MembraneMesh(flat, np.array([[0, 1, 2]]), np.array([True, False, False]))
    mu_h, area = 60.0, 0.5 * 2e-3 * 1.5e-3
    membrane = RubberMembrane(mesh, 0.0, inverse_metric(mesh), mu_h)
    l1, l2 = 1.4, 0.9
    x = flat * [l1, l2, 1.0]
    stored = membrane.energy(x) - membrane.energy(flat)
    invariant = l1**2 + l2**2 + (l1 * l2) ** -2
    assert stored == pytest.approx(0.5 * mu_h * area * (invariant - 3.0), rel=1e-12)
    assert np.abs(membrane.force(flat)).max() < 1e-15  # stress-free is free of stress
    stress = membrane.stress(x)[0]
    expected = mu_h * (np.array([l1, l2]) ** 2 - (l1 * l2) ** -2) / (l1 * l2)
    np.testing.assert_allclose(stress, np.diag([*expected, 0.0]), atol=1e-12)


def test_force_is_the_divergence_of_the_stress(mesh):
    """Nodal forces are Σ A T ∇φ, computed here from stress and shape functions alone."""
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.2)
    x = mesh.nodes + moved(mesh, membrane, 5e-4, 7)
    total = np.zeros_like(x)
    for t, stress in zip(mesh.triangles, membrane.stress(x), strict=True):
        a = x[t]
        normal = np.cross(a[1] - a[0], a[2] - a[0])
        for k in range(3):  # A ∇φ_k = n̂ × opposite edge / 2
            edge = a[(k + 2) % 3] - a[(k + 1) % 3]
            total[t[k]] += stress @ np.cross(normal / np.linalg.norm(normal), edge) / 2.0
    np.testing.assert_allclose(total, membrane.force(x), atol=1e-12)


@pytest.mark.parametrize("prestretch", [1.05, 1.5, None])
def test_reference_surface_has_its_tension_and_holds_its_pressure(prestretch):
    mesh = mesh_cap(spherical_cap(A, H), 1500)
    tension = GAUGE * (A**2 + H**2) / (4 * H)  # Young–Laplace of the sphere
    membrane = RubberMembrane.uniform(mesh, GAUGE, tension, prestretch)
    stress = membrane.stress(mesh.nodes)
    assert np.trace(stress, axis1=1, axis2=2) == pytest.approx(2 * tension, rel=1e-12)
    load = GAUGE * mesh.areas[mesh.free].sum()
    assert np.linalg.norm(membrane.rest_force[mesh.free].sum(axis=0)) < 2e-3 * load
    assert np.abs(membrane.residual(mesh.nodes, GAUGE)).max() < 1e-12
    # what the rim holds is what the gas pushes on its opening
    pull = -membrane.rest_force[mesh.rim].sum(axis=0)
    rim = mesh.nodes[mesh.rim]
    order = np.argsort(np.arctan2(rim[:, 1], rim[:, 0]))
    (x, y), (u, v) = rim[order, :2].T, np.roll(rim[order, :2], -1, axis=0).T
    assert pull[2] == pytest.approx(GAUGE * 0.5 * np.sum(x * v - u * y), rel=5e-3)


def test_highly_stretched_rubber_equals_the_linear_membrane():
    """λ → ∞: ∂W/∂x is γ0 × cotangent Laplacian, the paper's stiffness, at any shape."""
    mesh = mesh_cap(spherical_cap(A, H), 200)
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, 100.0)
    x = mesh.nodes + moved(mesh, membrane, 1e-4, 8)
    linear = TENSION * (cotangent_laplacian(mesh) @ x)
    np.testing.assert_allclose(membrane.force(x), linear, atol=1e-7 * np.abs(linear).max())


def test_elastic_rim_gives_slack_under_tension():
    mesh = mesh_cap(spherical_cap(A, H), 400)
    slack = 2e-4
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.2, slack)
    x = mesh.nodes.copy()
    x[mesh.rim, 2] += slack
    clamped = RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.2)
    springs = (membrane.force(x) - clamped.force(x))[mesh.rim, 2]
    assert springs.sum() == pytest.approx(TENSION * 2 * np.pi * A, rel=2e-3)


@pytest.mark.parametrize(
    ("tension", "prestretch", "said"),
    [(76.0, 1.0, "prestretch"), (76.0, np.nan, "prestretch"), (0.0, 1.2, "tension")],
)
def test_invalid_material_parameters_are_refused(mesh, tension, prestretch, said):
    with pytest.raises(InputError, match=said):
        RubberMembrane.uniform(mesh, GAUGE, tension, prestretch)


def test_triangles_of_no_area_have_no_finite_energy(mesh):
    membrane = RubberMembrane.uniform(mesh, GAUGE, TENSION, 1.2)
    flat = mesh.nodes.copy()
    flat[mesh.triangles[0, 1]] = flat[mesh.triangles[0, 0]]
    assert membrane.energy(flat) == np.inf
