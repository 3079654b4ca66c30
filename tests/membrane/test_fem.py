"""Stiffness, areas and volumes against exact values."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from bubbleviz.membrane import (
    EllipsoidalCap,
    MembraneMesh,
    balance_tension,
    cotangent_laplacian,
    mesh_cap,
    spherical_cap,
)

A, H = 0.075, 0.050
SPHERE = (A**2 + H**2) / (2 * H)


def flat_disc(nodes, radius=1.0):
    cap = mesh_cap(spherical_cap(1.0, 0.02), nodes)
    return MembraneMesh(cap.nodes * [radius, radius, 0.0], cap.triangles, cap.rim)


def test_manufactured_solution_converges_with_h_squared():
    """−∇²u = f with u = cos(2x + y) e^{x/2} on the disc, boundary values given."""

    def exact(x, y):
        return np.cos(2 * x + y) * np.exp(0.5 * x)

    def load(x, y):
        c, s, e = np.cos(2 * x + y), np.sin(2 * x + y), np.exp(0.5 * x)
        return (5.0 * c - 0.25 * c + 2.0 * s) * e

    sizes, errors = [], []
    for nodes in (200, 800, 3200, 12800):
        mesh = flat_disc(nodes)
        x, y, _ = mesh.nodes.T
        u = exact(x, y)
        free, rim = mesh.free, np.flatnonzero(mesh.rim)
        L = cotangent_laplacian(mesh)
        rhs = (mesh.areas * load(x, y))[free] - L[free][:, rim] @ u[rim]
        error = spsolve(L[free][:, free].tocsc(), rhs) - u[free]
        errors.append(np.sqrt(mesh.areas[free] @ error**2))
        sizes.append(np.sqrt(mesh.facet_areas.mean()))
    rate = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert 1.8 < rate < 2.4
    assert errors[-1] < 2e-4


def test_laplacian_is_symmetric_and_definite_on_free_nodes():
    mesh = mesh_cap(EllipsoidalCap.of((0.0557, 0.0396), 0.0305), 300)
    L = cotangent_laplacian(mesh)
    assert abs(L - L.T).max() < 1e-12
    np.testing.assert_allclose(L.sum(axis=1), 0.0, atol=1e-12)
    inner = L[mesh.free][:, mesh.free].toarray()
    assert np.linalg.eigvalsh(inner).min() > 1e-3
    off = inner - np.diag(np.diag(inner))
    assert off.max() < 1e-6  # Delaunay: an M-matrix, which the contact solver counts on


def test_areas_add_up_to_the_sphere():
    exact = 2 * np.pi * SPHERE * H
    errors = [abs(mesh_cap(spherical_cap(A, H), n).areas.sum() / exact - 1) for n in (800, 3200)]
    assert errors[0] < 3e-3
    assert errors[1] < 0.3 * errors[0]


@pytest.mark.parametrize("height", [0.02 * A, H, A, 2 * A])
def test_cap_volume_equals_the_analytic_one(height):
    exact = np.pi * height * (3 * A**2 + height**2) / 6
    errors = [
        abs(mesh_cap(spherical_cap(A, height), n).cap_volume() / exact - 1) for n in (800, 3200)
    ]
    assert errors[0] < 8e-3
    assert errors[1] < 0.3 * errors[0]


def test_first_order_volume_change_is_area_times_displacement():
    """dV = Aᵀu (not Aᵀu/3, Eq. 9): against the finite difference of the signed volume."""
    mesh = mesh_cap(spherical_cap(A, H), 1500)
    rng = np.random.default_rng(3)
    x, y, z = (mesh.nodes / A).T
    for _ in range(3):
        a, b, c = rng.standard_normal(3)
        u = 1e-6 * (a * np.cos(3 * x + b) + c * y * x + 1.0) * z * ~mesh.rim
        difference = 0.5 * (mesh.cap_volume(u) - mesh.cap_volume(-u))
        assert difference == pytest.approx(mesh.areas @ u, rel=3e-3)


@pytest.mark.parametrize("height", [0.2 * A, H, A])
def test_tension_obeys_young_laplace(height):
    radius = (A**2 + height**2) / (2 * height)
    exact = 2585.5 * radius / 2
    for nodes in (800, 3200):  # curvature at single nodes is rough: 0.1 % stays
        tension = balance_tension(mesh_cap(spherical_cap(A, height), nodes), 2585.5)
        assert tension == pytest.approx(exact, rel=2e-3)
