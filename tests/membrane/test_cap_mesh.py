"""Meshes of analytic surfaces: on the surface, even, well shaped, without a preferred direction."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bubbleviz.membrane import (
    EllipsoidalCap,
    build_mesh,
    mesh_cap,
    refinement,
    spherical_cap,
    triangles_across,
)
from bubbleviz.sensor import load_sensor

A = 0.075
CAPS = {
    "2 % high": spherical_cap(A, 0.02 * A),
    "paper": spherical_cap(A, 0.05),
    "hemisphere": spherical_cap(A, A),
    "beyond": spherical_cap(A, 2.0 * A),
    "oval": EllipsoidalCap.of((0.0557, 0.0396), 0.0305),
    "oval, tall": EllipsoidalCap.of((0.0557, 0.0396), 0.06),
}


@pytest.mark.parametrize("nodes", [30, 100, 800, 3000])
@pytest.mark.parametrize("name", CAPS)
def test_shape_and_count(name, nodes):
    cap = CAPS[name]
    mesh = mesh_cap(cap, nodes)
    assert len(mesh.nodes) == pytest.approx(nodes, rel=0.05)
    assert np.degrees(mesh.angles.min()) >= 30.0
    assert mesh.facet_areas.max() < 2.6 * mesh.facet_areas.min()
    inside = (mesh.nodes - cap.centre) / cap.semi_axes
    np.testing.assert_allclose(np.linalg.norm(inside, axis=1), 1.0, atol=1e-9)
    rim = mesh.nodes[mesh.rim]
    np.testing.assert_array_equal(rim[:, 2], 0.0)
    np.testing.assert_allclose(np.hypot(*(rim[:, :2] / cap.rim_semi_axes_m).T), 1.0, atol=1e-9)
    assert (mesh.nodes[~mesh.rim, 2] > 0.0).all()


@pytest.mark.parametrize("name", CAPS)
def test_mesh_is_a_disc_with_outward_normals(name):
    mesh = mesh_cap(CAPS[name], 400)
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    assert len(mesh.nodes) - len(unique) + len(mesh.triangles) == 1  # Euler: a disc
    assert set(np.unique(unique[count == 1])) == set(np.flatnonzero(mesh.rim))
    middles = mesh.nodes[mesh.triangles].mean(axis=1) - CAPS[name].centre
    assert (np.einsum("ij,ij->i", mesh.facet_vectors, middles) > 0.0).all()


def test_mesh_is_isotropic():
    """Edges point everywhere alike: second moments of their azimuths vanish over the dome's top."""
    mesh = mesh_cap(spherical_cap(A, 0.02 * A), 3000)
    edges = mesh.nodes[mesh.triangles[:, [1, 2, 0]]] - mesh.nodes[mesh.triangles]
    angle = np.arctan2(edges[..., 1], edges[..., 0]).ravel()
    for order, most in ((2, 0.05), (4, 0.05), (6, 0.25)):  # 6: 1 on a hexagonal lattice
        assert abs(np.exp(1j * order * angle).mean()) < most


def test_ellipsoidal_cap_with_equal_axes_is_the_spherical_cap():
    radius = (A**2 + 0.05**2) / 0.1
    np.testing.assert_allclose(spherical_cap(A, 0.05).semi_axes, radius)
    given = EllipsoidalCap.of((0.0557, 0.0396), 0.0305, 0.0437)  # the Punyo sensor as measured
    np.testing.assert_allclose(given.semi_axes, [0.0585, 0.0416, 0.0437], atol=2e-4)


def test_mesh_is_deterministic():
    cap = CAPS["paper"]
    first = mesh_cap(cap, 3000)
    np.testing.assert_array_equal(first.nodes, mesh_cap(cap, 3000).nodes)


def test_build_mesh_follows_the_sensor_file():
    sensor = load_sensor("pico_flexx_75mm")
    mesh = build_mesh(sensor)
    assert len(mesh.nodes) == pytest.approx(sensor.membrane.nodes, rel=0.05)
    assert mesh.nodes[:, 2].max() == pytest.approx(0.05, abs=1e-12)
    assert len(build_mesh(sensor, 200).nodes) == pytest.approx(200, rel=0.05)
    assert build_mesh(sensor) is mesh  # made once for all recordings of a sensor


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), share=st.floats(0.0, 0.6))
def test_local_refinement_keeps_the_surface_connected(seed, share):
    mesh = mesh_cap(CAPS["oval"], 200)
    chosen = np.random.default_rng(seed).random(len(mesh.triangles)) < share
    fine = refinement(mesh, chosen).mesh
    assert np.allclose(fine.facet_areas.sum(), mesh.facet_areas.sum(), rtol=1e-12)
    assert np.allclose(fine.cap_volume(), mesh.cap_volume(), rtol=1e-12)
    assert len(fine.triangles) >= len(mesh.triangles) + 3 * chosen.sum()
    assert np.abs(fine.nodes[fine.rim, 2]).max() == 0.0
    whole = refinement(mesh).mesh
    assert len(whole.triangles) == 4 * len(mesh.triangles) and whole.rim.sum() == 2 * mesh.rim.sum()
    across = triangles_across(fine.triangles)
    sides = np.stack([np.roll(fine.triangles, -1, axis=1), np.roll(fine.triangles, -2, axis=1)], -1)
    assert fine.rim[sides[across < 0]].all()  # no hanging node: every open side is on the rim
    assert len(np.unique(fine.triangles)) == len(fine.nodes)
