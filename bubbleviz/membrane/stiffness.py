"""Stiffness of the membrane: K = γ0 × cotangent Laplacian (Eqs. 3 and 4)."""

from __future__ import annotations

import numpy as np
from scipy import sparse

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


def young_laplace_tension(mesh: MembraneMesh, gauge_pressure_pa: float) -> float:
    """Tension γ0 in N/m that holds the reference surface in equilibrium (Eq. 2).

    Area-weighted least squares of γ0 (L x)·n̂ against A P over the free nodes; for a spherical
    cap this is γ0 = P R / 2.
    """
    laplacian = cotangent_laplacian(mesh)
    free = mesh.free
    curvature = np.einsum("ij,ij->i", laplacian @ mesh.nodes, mesh.normals)[free]
    areas = mesh.areas[free]
    mean_curvature = curvature / areas  # κ1 + κ2 at each node
    return float(gauge_pressure_pa * np.sum(areas * mean_curvature) / np.sum(curvature**2 / areas))
