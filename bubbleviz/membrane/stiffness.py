"""Stiffness of the membrane: K = γ0 × cotangent Laplacian (Eqs. 3 and 4)."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh


def cotangent_laplacian(mesh: MembraneMesh) -> sparse.csr_array:
    """P1 stiffness matrix L of −∇² on the mesh, n×n, symmetric, dimensionless.

    K = γ0 L. It is positive definite only on the free nodes: eliminate the rim's rows and
    columns before factorising.
    """
    i, j, k = mesh.triangles.T
    cotangents = 0.5 / np.tan(mesh.angles)
    rows = np.concatenate([j, k, i])  # the edge opposite each corner
    cols = np.concatenate([k, i, j])
    weights = cotangents.T.ravel()
    n = len(mesh.nodes)
    half = sparse.csr_array((weights, (rows, cols)), shape=(n, n))
    off = half + half.T
    return (sparse.diags_array(off.sum(axis=1)) - off).tocsr()


def mean_curvature(mesh: MembraneMesh) -> float:
    """Mean of κ1 + κ2 over the surface, 1/m: Σ (L x)·n̂ / Σ A.

    The tension γ0 holds the gauge pressure γ0 (κ1 + κ2) in the reference configuration (Eq. 2).
    Linear in the curvature, so that the bumps of a measured surface cancel in the sum.
    """
    area, bending = area_and_bending(mesh)
    return bending / area


def area_and_bending(mesh: MembraneMesh) -> tuple[float, float]:
    """Area of the surface, m², and Σ (L x)·n̂ over its free nodes with their shares, m."""
    bending = np.einsum("ij,ij->i", cotangent_laplacian(mesh) @ mesh.nodes, mesh.normals)
    return float(mesh.areas.sum()), float(area_shares(mesh) @ bending)


def area_shares(mesh: MembraneMesh) -> np.ndarray:
    """Area that each node stands for over its own, (n,): rim nodes' goes to their neighbours."""
    start, end = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
    both = np.stack([np.concatenate([start, end]), np.concatenate([end, start])], axis=1)
    edges = np.unique(both, axis=0)
    edges = edges[mesh.rim[edges[:, 0]] & ~mesh.rim[edges[:, 1]]]  # from the rim inward
    count = len(mesh.nodes)
    heirs = np.bincount(edges[:, 0], minlength=count)
    given = mesh.areas[edges[:, 0]] / heirs[edges[:, 0]]
    total = np.where(mesh.rim, 0.0, mesh.areas) + np.bincount(edges[:, 1], given, minlength=count)
    # A rim node without a free neighbour (a corner) leaves its area to all.
    return total / mesh.areas * mesh.areas.sum() / total.sum()


def balance_tension(mesh: MembraneMesh, gauge_pressure_pa: float) -> float:
    """Tension γ0 in N/m from the balance over the whole surface: P ΣA = γ0 Σ (L x)·n̂ (Eq. 2).

    Young–Laplace summed over the free nodes, each with its share of its neighbours' area on the
    rim, where L x holds the housing's pull besides the curvature. It is linear in the curvature,
    whose errors on a measured surface cancel in the sum. For a spherical cap it is P R / 2.

    Raises InputError: the surface is flat or hollow, so that no tension holds it.
    """
    area, bending = area_and_bending(mesh)
    if not bending > 0.0:
        raise InputError("reference surface: flat or hollow, so no tension holds it; inflate it")
    return gauge_pressure_pa * area / bending
