"""Cramér–Rao bound of the position of the patch edge.

The true loads are displaced along the membrane by a field that is a polynomial in each of two
directions: degree 1 is translation, rotation and strain of the patch, degree 3 also changes its
shape. The estimator's linearised model maps the field to ranges, and their noise gives the
covariance of the coefficients. As a prior, the edge is known to half the width of the patch, which
keeps the bound finite where noise hides the shape (van Trees). The pressure counts as known:
otherwise the error is larger. More knowledge of the shape, such as that it is round, allows smaller
errors than the bound of degree 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from bubbleviz.inverse import Estimator, touching_share
from bubbleviz.membrane import MembraneMesh, TriangleScene, level_line
from bubbleviz.simulation import SimulatedPress
from bubbleviz.study.accuracy import at_nodes

PLACE, SHAPE = 1, 3  # degrees of the fields
_STEP_M = 1e-5  # of the derivative by the loads' positions: far below an edge of the mesh


@dataclass(frozen=True)
class EdgeBound:
    """Lower bound of the edge's standard deviation, m, and the mean IoU that it allows."""

    sigma_m: float
    iou: float


def edge_bound(
    estimator: Estimator,
    sighting: SimulatedPress,
    degree: int,  # of the fields, `PLACE` or `SHAPE`
) -> EdgeBound:
    """Bound for one press under the noise that the estimator assumes."""
    truth, own, mesh = sighting.truth, sighting.mesh, estimator.mesh
    touching = truth.contact_pressure_pa > 0.0
    places = own.nodes[touching]
    load = (truth.contact_pressure_pa * own.areas)[touching]
    center = places.mean(axis=0)
    radius = float(np.linalg.norm(places - center, axis=1).max())

    def fields(points: np.ndarray) -> np.ndarray:
        return _fields((points - center)[:, :2] / radius, degree)

    moved = np.stack(
        [
            (_spread(mesh, places + _STEP_M * v, load) - _spread(mesh, places - _STEP_M * v, load))
            / (2.0 * _STEP_M)
            for v in fields(places)
        ],
        axis=1,
    )
    response = _ranges(estimator, sighting, moved, _spread(mesh, places, load))
    edge, normal, length = _edge(own, touching_share(own, truth.contact_pressure_pa))
    at_edge = fields(edge)
    half_width = truth.patch_area_m2 / length.sum()
    count = 0.5 * len(at_edge)  # fields in each direction
    before = np.einsum("isk,jsk,s->ij", at_edge, at_edge, length) / length.sum()
    covariance = np.linalg.inv(response.T @ response + before * count / half_width**2)
    across = np.einsum("isk,sk->si", at_edge, normal)
    sigma = np.sqrt(np.einsum("si,ij,sj->s", across, covariance, across))
    lost = np.sqrt(2.0 / np.pi) * float(sigma @ length)
    area = truth.patch_area_m2
    rms = float(np.sqrt(sigma**2 @ length / length.sum()))
    return EdgeBound(rms, (area - 0.5 * lost) / (area + 0.5 * lost))


def _fields(points: np.ndarray, degree: int) -> np.ndarray:
    """Motions along x or y, monomials of points (k, 2), (m, k, 3)."""
    x, y = points.T
    powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    monomials = np.stack([x**a * y**b for a, b in powers])
    return np.concatenate([monomials[..., None] * axis for axis in np.eye(3)[:2]])


def _spread(mesh: MembraneMesh, places: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Loads at points (k, 3) distributed to the nodes (n,), N."""
    found = TriangleScene(mesh.nodes, mesh.triangles).closest(places)
    corners = mesh.triangles[found.triangle].ravel()
    shared = (found.barycentric * load[:, None]).ravel()
    return np.bincount(corners, shared, minlength=len(mesh.nodes))


def _ranges(
    estimator: Estimator, sighting: SimulatedPress, moved: np.ndarray, load: np.ndarray
) -> np.ndarray:
    """Changes of the ranges, in standard deviations (k, m), by changes of nodal loads (n, m)."""
    mesh, own = estimator.mesh, sighting.mesh
    x = mesh.nodes + at_nodes(mesh, own, sighting.truth.displacement_3d_m)
    view = estimator.observer.around(x)
    weight = estimator.observer.observe_everything().weight[view.block]
    rubber = estimator.bubble.linearised(x, load / mesh.areas, None)
    nodes = np.flatnonzero(moved.any(axis=1) & ~mesh.rim)
    area = np.linalg.norm(rubber.area_vectors[nodes], axis=1)
    motion = rubber.responses(nodes) @ (moved[nodes] / area[:, None])
    ranges: np.ndarray = np.sqrt(weight)[:, None] * (view.jacobian @ motion)
    return ranges


def _edge(mesh: MembraneMesh, share: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Midpoints (s, 3) of the segments of the edge, their in-plane normals and lengths."""
    pieces = level_line(mesh.nodes, mesh.corners, share - 0.5)
    middle, along = pieces.mean(axis=1), pieces[:, 1] - pieces[:, 0]
    normal = np.cross(along, mesh.normals[cKDTree(mesh.nodes).query(middle)[1]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return middle, normal, np.linalg.norm(along, axis=1)
