"""What the estimated membrane says about an object that touches it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.membrane.mesh import MembraneMesh, area_vectors
from bubbleviz.result import Estimate, Patch

LEAST_POINTS = 12
"""Contact points below which there is no patch to speak of: two triangles of the mesh."""

_REACH_M = 0.008  # how far around the patch the free membrane is looked at

_MOST = 160  # contact points, and free ones, beyond which more of them say the same again

_CENTRES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
"""Barycentric coordinates of the centres of a triangle's four quarters."""


@dataclass(frozen=True)
class ContactPoints:
    """Points of the membrane in B, on and around the contact patch."""

    # points, normals: (k, 3), on the patch, with the membrane's outward unit normals, which oppose
    # the object's
    points: np.ndarray
    normals: np.ndarray
    areas_m2: np.ndarray  # (k,), the part of the membrane that each stands for
    pressure_pa: np.ndarray  # (k,), contact pressure
    free: np.ndarray  # (f, 3), around the patch, where the membrane touches nothing
    free_areas_m2: np.ndarray  # (f,)
    center: np.ndarray  # (3,), mean of `points`, weighted by area
    radius_m: float  # their root mean square distance from it
    rest_center: np.ndarray  # (3,), where that part of the membrane was at rest, on average
    membrane: np.ndarray  # (n, 3), all nodes of the membrane, as estimated

    @property
    def extent_m(self) -> float:
        """Largest distance of a contact point from the centre."""
        return float(np.linalg.norm(self.points - self.center, axis=1).max())


def contact_points(mesh: MembraneMesh, estimate: Estimate, patch: Patch) -> ContactPoints | None:
    """Contact points of an estimate; None where the patch has fewer than a pose needs."""
    nodes = mesh.deformed(estimate.motion_m)
    inside = patch.level > 0.0
    near = np.any(inside[mesh.triangles], axis=1)
    if not near.any():
        return None
    middle = nodes[mesh.triangles[near]].mean(axis=1)
    box = np.abs(nodes - middle.mean(axis=0)).max(axis=1)
    around = box < np.abs(middle - middle.mean(axis=0)).max() + _REACH_M + 2.0 * mesh.edge_length
    triangles = mesh.triangles[np.all(around[mesh.triangles], axis=1)]
    corners = nodes[triangles]
    vectors = area_vectors(nodes, triangles)
    areas = np.linalg.norm(vectors, axis=1)
    points = np.einsum("qj,tjk->tqk", _CENTRES, corners).reshape(-1, 3)
    level = (patch.level[triangles] @ _CENTRES.T).ravel()
    pressure = (estimate.contact_pressure_pa[triangles] @ _CENTRES.T).ravel()
    on = np.flatnonzero(level > 0.0)
    if len(on) < LEAST_POINTS:
        return None
    facets = vectors / areas[:, None]
    share = 0.25 * np.repeat(areas, 4)
    center = share[on] @ points[on] / share[on].sum()
    at_rest = np.einsum("qj,tjk->tqk", _CENTRES, mesh.nodes[triangles]).reshape(-1, 3)
    spread = share[on] @ np.sum((points[on] - center) ** 2, axis=1) / share[on].sum()
    off = np.flatnonzero(level <= 0.0)
    free = _thinned(off[_within(points[off], points[on], _REACH_M)])
    kept = _thinned(on)
    return ContactPoints(
        points=points[kept],
        normals=facets[kept // 4],
        areas_m2=share[kept] * (share[on].sum() / share[kept].sum()),
        pressure_pa=pressure[kept],
        free=points[free],
        free_areas_m2=np.full(len(free), share[on].mean()),
        center=center,
        radius_m=float(np.sqrt(spread)),
        rest_center=share[on] @ at_rest[on] / share[on].sum(),
        membrane=nodes,
    )


def _thinned(index: np.ndarray) -> np.ndarray:
    """Some of the points, evenly spread in the mesh's own order."""
    return index[:: max(1, -(-len(index) // _MOST))]


def _within(points: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """Which points (k, 3) have one of the others closer than `reach`."""
    distance, _ = cKDTree(others).query(points, distance_upper_bound=reach)
    return np.isfinite(distance)
