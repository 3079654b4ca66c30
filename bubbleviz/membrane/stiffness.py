"""Tension of the membrane by force balance (Eq. 2), and its stiffness K = γ0 L (Eqs. 3, 4)."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh, cotangent_laplacian
from bubbleviz.membrane.sparse_factor import symmetric_lu


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
    """Factor (n,) by which nodes' areas grow when free nodes take over those of the rim."""
    count, (node, neighbour) = len(mesh.nodes), mesh.neighbours
    inward = mesh.rim[node] & ~mesh.rim[neighbour]
    node, neighbour = node[inward], neighbour[inward]
    given = mesh.areas[node] / np.bincount(node, minlength=count)[node]
    total = np.where(mesh.rim, 0.0, mesh.areas) + np.bincount(neighbour, given, minlength=count)
    # A rim node without a free neighbour (a corner) leaves its area to all.
    return total / mesh.areas * mesh.areas.sum() / total.sum()


def balance_tension(mesh: MembraneMesh, gauge_pressure_pa: float) -> float:
    """Tension γ0 in N/m from the balance over the whole surface: P ΣA = γ0 Σ (L x)·n̂ (Eq. 2).

    Young–Laplace summed over the free nodes, each with its share of its neighbours' area on the
    rim, where L x holds the housing's pull besides the curvature. It is linear in the curvature,
    whose errors on a measured surface cancel in the sum. For a spherical cap it is P R / 2.

    Raises InputError: the surface is flat or concave, so that no tension holds it.
    """
    area, bending = area_and_bending(mesh)
    if not bending > 0.0:
        raise InputError(
            "the reference surface is flat or concave, so no tension balances the gauge pressure; "
            "inflate the sensor and identify it again, or correct the surface in the sensor file"
        )
    return gauge_pressure_pa * area / bending


def balance_gradient(mesh: MembraneMesh, gauge_pressure_pa: float, arms: np.ndarray) -> np.ndarray:
    """Derivative of `balance_tension` for motion of each node along its arm (n, 3); (n,), Pa.

    Σ (L x)·n̂ over the free nodes is the rate at which the area grows when they move along their
    normals, so that its derivative is the area's second derivative in that direction: L x is the
    gradient of the area, taken here at two surfaces a little outside and inside. That the
    normals turn as well changes nothing to first order, because L x is parallel to them.
    """
    area, bending = area_and_bending(mesh)
    outward = area_shares(mesh)[:, None] * mesh.normals
    step = 1e-4 * float(np.sqrt(mesh.areas.sum()))

    def area_gradient(shift: float) -> np.ndarray:
        moved = MembraneMesh(mesh.nodes + shift * outward, mesh.triangles, mesh.rim)
        return cotangent_laplacian(moved) @ moved.nodes

    of_bending = (area_gradient(step) - area_gradient(-step)) / (2.0 * step)
    of_area = cotangent_laplacian(mesh) @ mesh.nodes
    gradient = of_area / bending - area / bending**2 * of_bending
    return gauge_pressure_pa * np.einsum("ij,ij->i", gradient, arms)


def local_tension(
    mesh: MembraneMesh,
    gauge_pressure_pa: float,
    scale_m: float,  # length over which the balance is averaged (one step of implicit diffusion), m
) -> np.ndarray:
    """γ0 by balance over the neighbourhood of every node, (n,), N/m; NaN on the rim, where flat."""
    free, laplacian = mesh.free, cotangent_laplacian(mesh)
    bending = np.einsum("ij,ij->i", laplacian @ mesh.nodes, mesh.normals)[free]
    mass = sparse.diags_array(mesh.areas[free])
    blur = symmetric_lu((mass + scale_m**2 * laplacian[free][:, free]).tocsc())
    smooth, ones = blur.solve(bending), blur.solve(mesh.areas[free])
    tension = np.full(len(mesh.nodes), np.nan)
    with np.errstate(divide="ignore"):
        tension[free] = np.where(smooth > 0.0, gauge_pressure_pa * ones / smooth, np.nan)
    return tension
