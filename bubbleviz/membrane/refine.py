"""A finer mesh of the same facets."""

from __future__ import annotations

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh


def refine(mesh: MembraneMesh) -> MembraneMesh:
    """Every triangle cut into four at the middles of its edges; about four times the nodes."""
    n = len(mesh.nodes)
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, which, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    ab, bc, ca = (which.reshape(-1, 3) + n).T
    a, b, c = mesh.triangles.T
    quarters = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return MembraneMesh(
        nodes=np.concatenate([mesh.nodes, mesh.nodes[unique].mean(axis=1)]),
        triangles=np.concatenate([np.stack(q, axis=1) for q in quarters]),
        rim=np.concatenate([mesh.rim, count == 1]),
    )
