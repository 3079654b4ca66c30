"""γ0 of a measured surface: Young–Laplace in a form that bumps do not bias."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from bubbleviz.calibration.surface.cap_fit import Ellipsoid
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.stiffness import area_and_bending, area_shares, cotangent_laplacian
from bubbleviz.membrane.symmetric_lu import symmetric_lu


def least_squares_tension(mesh: MembraneMesh, gauge_pressure_pa: float) -> float:
    """γ0 in N/m by least squares of γ0 (L x)·n̂ against A P over the free nodes: for comparison.

    It divides by the sum of squares of the curvature, which every bump makes larger: on the Punyo
    sensor it falls from 130 to 112 N/m as the mesh is refined, `balance_tension` stays within 1 %.
    """
    free = mesh.free
    curvature = np.einsum("ij,ij->i", cotangent_laplacian(mesh) @ mesh.nodes, mesh.normals)[free]
    return float(gauge_pressure_pa * np.sum(curvature) / np.sum(curvature**2 / mesh.areas[free]))


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


def cap_tension(
    ellipsoid: Ellipsoid, facets: np.ndarray, areas: np.ndarray, gauge_pressure_pa: float
) -> float:
    """γ0 in N/m by balance over the part of an ellipsoid that facets stand for: P / mean(κ1 + κ2).

    Parameters
    ----------
    ellipsoid : Ellipsoid
    facets : (m, 3) array
        Centres of the facets of a mesh of it, m.
    areas : (m,) array
        Their areas, m².
    gauge_pressure_pa : float
    """
    curvature = ellipsoid_curvature(ellipsoid, facets)
    return gauge_pressure_pa * float(areas.sum() / (areas @ curvature))


def ellipsoid_curvature(ellipsoid: Ellipsoid, points: np.ndarray) -> np.ndarray:
    """κ1 + κ2 in 1/m of an ellipsoid below or above points (k, 3), on the line to its centre.

    2H = (Σa² − Σx²) / (Πa² (Σx²/a⁴)^{3/2}) (Gray, Modern Differential Geometry, 3rd ed., 13.5).
    """
    a = ellipsoid.semi_axes_m
    local = (points - ellipsoid.centre_m) @ ellipsoid.axes
    local = local / np.linalg.norm(local / a, axis=1, keepdims=True)
    q = np.sum(local**2 / a**4, axis=1)
    return (np.sum(a**2) - np.sum(local**2, axis=1)) / (np.prod(a**2) * q**1.5)


def local_tension(mesh: MembraneMesh, gauge_pressure_pa: float, scale_m: float) -> np.ndarray:
    """γ0 by balance over the neighbourhood of every node, (n,), N/m; NaN on the rim, where flat.

    Parameters
    ----------
    mesh : MembraneMesh
    gauge_pressure_pa : float
    scale_m : float
        Length over which the balance is averaged (one step of implicit diffusion), m.
    """
    free, laplacian = mesh.free, cotangent_laplacian(mesh)
    bending = np.einsum("ij,ij->i", laplacian @ mesh.nodes, mesh.normals)[free]
    mass = sparse.diags_array(mesh.areas[free])
    blur = symmetric_lu((mass + scale_m**2 * laplacian[free][:, free]).tocsc())
    smooth, ones = blur.solve(bending), blur.solve(mesh.areas[free])
    tension = np.full(len(mesh.nodes), np.nan)
    with np.errstate(divide="ignore"):
        tension[free] = np.where(smooth > 0.0, gauge_pressure_pa * ones / smooth, np.nan)
    return tension
