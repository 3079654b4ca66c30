"""Objects whose sharp edges are rounded: a core inside them and all that is within a radius of it.

Nodes of a membrane cannot slide over a perfectly sharp edge. The triangle that spans it is kinked
at one corner on either side, and the tensions of the two sides need not be equal however fine the
mesh: the nodes catch on the edge as if there were friction. Over a rounding that is wider than
their distance they slide.
"""

from __future__ import annotations

import numpy as np

from bubbleviz.membrane.mesh import area_vectors
from bubbleviz.rigid_object import RigidObject

_ALIKE = 0.01
"""Share of the largest eigenvalue below which normals at a vertex count as lying in a plane."""
_TRIES = 4  # times that a radius too large for an object's thinnest part or finest fillet is halved


def core_of(
    obj: RigidObject,  # watertight, counter-clockwise seen from outside
    radius_m: float,
) -> tuple[np.ndarray, float]:
    """Vertices (n, 3) of an object moved inward until its facets are a radius deeper, and that, m.

    Places at the radius from this core are on the object's faces, and on rounded edges between
    them. The radius is a fraction of the one given, or 0, where the core would turn inside out.
    """
    inward = _inward(obj)
    vectors = area_vectors(obj.vertices, obj.triangles)
    for _ in range(_TRIES):
        core = obj.vertices + radius_m * inward
        if (np.einsum("ij,ij->i", area_vectors(core, obj.triangles), vectors) > 0.0).all():
            return core, radius_m
        radius_m *= 0.5
    return obj.vertices, 0.0


def _inward(obj: RigidObject) -> np.ndarray:
    """Motion (n, 3) of the vertices, over the radius: all facets at a vertex go back by 1."""
    vectors = area_vectors(obj.vertices, obj.triangles)
    normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    squares = np.zeros((len(obj.vertices), 3, 3))
    sums = np.zeros_like(obj.vertices)
    for corner in obj.triangles.T:
        np.add.at(squares, corner, normals[:, :, None] * normals[:, None, :])
        np.add.at(sums, corner, normals)
    inverse = np.linalg.pinv(squares, rcond=_ALIKE, hermitian=True)
    moved: np.ndarray = -np.einsum("nij,nj->ni", inverse, sums)
    return moved
