"""A finer mesh of the same facets, everywhere or where it matters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh


class Refined(NamedTuple):
    """A finer mesh and where its nodes are on the coarser one.

    Attributes
    ----------
    mesh : MembraneMesh
        The coarser one's nodes come first.
    cut : (c, 2) int array
        Ends of the edges of the coarser mesh whose middles are the other nodes.
    """

    mesh: MembraneMesh
    cut: np.ndarray

    def values(self, coarse: np.ndarray) -> np.ndarray:
        """Values on the coarser nodes (n, …), interpolated linearly to the finer ones."""
        return np.concatenate([coarse, coarse[self.cut].mean(axis=1)])


def refine(mesh: MembraneMesh, chosen: np.ndarray | None = None) -> MembraneMesh:
    """Triangles cut into four at the middles of their edges; see `refinement`."""
    return refinement(mesh, chosen).mesh


def refinement(mesh: MembraneMesh, chosen: np.ndarray | None = None) -> Refined:
    """Cut triangles into four at the middles of their edges.

    Parameters
    ----------
    mesh : MembraneMesh
    chosen : (m,) bool array, optional
        Triangles to cut, all by default. A neighbour with one edge cut is halved, one with more is
        cut into four itself, so that the mesh stays conforming (Bank, Sherman and Weiser 1983).
    """
    n, corners = len(mesh.nodes), mesh.triangles
    sides = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, which, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1, 3)
    cut = np.zeros(len(edges), bool)
    cut[which if chosen is None else which[chosen]] = True
    while np.any(uneven := cut[which].sum(axis=1) == 2):
        cut[which[uneven]] = True
    middle = np.full(len(edges), -1)
    middle[cut] = n + np.arange(np.count_nonzero(cut))
    ways = cut[which].sum(axis=1)
    (a, b, c), (ab, bc, ca) = corners[ways == 3].T, middle[which[ways == 3]].T
    parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    for k in range(3):
        halved = (ways == 1) & cut[which[:, k]]
        a, b, c = corners[halved][:, [k, (k + 1) % 3, (k + 2) % 3]].T
        m = middle[which[halved, k]]
        parts += [(a, m, c), (m, b, c)]
    finer = MembraneMesh(
        nodes=np.concatenate([mesh.nodes, mesh.nodes[edges[cut]].mean(axis=1)]),
        triangles=np.concatenate([corners[ways == 0], *(np.stack(p, axis=1) for p in parts)]),
        rim=np.concatenate([mesh.rim, count[cut] == 1]),
    )
    return Refined(finer, edges[cut])
