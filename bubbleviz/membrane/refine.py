"""A finer mesh of the same facets, everywhere or where it matters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh, triangles_across


class Refined(NamedTuple):
    """A finer mesh and where its nodes are on the coarser one."""

    mesh: MembraneMesh  # the coarser one's nodes come first
    # (k, 2) int, nodes of the coarser mesh that each node lies midway between; twice the same for
    # its own
    ends: np.ndarray
    parent: np.ndarray  # (m,) int, triangle of the coarser mesh that each triangle is part of

    def values(self, coarse: np.ndarray) -> np.ndarray:
        """Values on the coarser nodes (n, …), interpolated linearly to the finer ones."""
        return midway(coarse, self.ends)


def midway(coarse: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Means of the values (n, …) of pairs of nodes (k, 2), (k, …)."""
    values: np.ndarray = 0.5 * (coarse[ends[:, 0]] + coarse[ends[:, 1]])
    return values


def refined_part(mesh: MembraneMesh, inside: np.ndarray, chosen: np.ndarray) -> Refined:
    """Part of a mesh with some of its triangles cut into four.

    Parameters
    ----------
    mesh : MembraneMesh
    inside, chosen : (m,) bool array
        Triangles of the part, and those to cut. Where the part ends its nodes are held.
    """
    triangles = np.flatnonzero(inside)
    nodes, corners = np.unique(mesh.triangles[triangles], return_inverse=True)
    part = MembraneMesh(mesh.nodes[nodes], corners.reshape(-1, 3), mesh.rim[nodes])
    triangle, corner = np.nonzero(triangles_across(part.triangles) < 0)
    part.rim[part.triangles[triangle, (corner + 1) % 3]] = True
    part.rim[part.triangles[triangle, (corner + 2) % 3]] = True
    finer = refinement(part, chosen[triangles])
    return Refined(finer.mesh, nodes[finer.ends], triangles[finer.parent])


def refine(mesh: MembraneMesh, chosen: np.ndarray | None = None) -> MembraneMesh:
    """Triangles cut into four at the middles of their edges; see `refinement`."""
    return refinement(mesh, chosen).mesh


def refinement(
    mesh: MembraneMesh,
    # (m,) bool, triangles to cut, all by default. A neighbour with one edge cut is halved, one with
    # more is cut into four itself, so that the mesh stays conforming (Bank, Sherman and Weiser
    # 1983).
    chosen: np.ndarray | None = None,
) -> Refined:
    """Cut triangles into four at the middles of their edges."""
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
    parents = [np.flatnonzero(ways == 0), *4 * [np.flatnonzero(ways == 3)]]
    for k in range(3):
        halved = (ways == 1) & cut[which[:, k]]
        a, b, c = corners[halved][:, [k, (k + 1) % 3, (k + 2) % 3]].T
        m = middle[which[halved, k]]
        parts += [(a, m, c), (m, b, c)]
        parents += 2 * [np.flatnonzero(halved)]
    finer = MembraneMesh(
        nodes=np.concatenate([mesh.nodes, mesh.nodes[edges[cut]].mean(axis=1)]),
        triangles=np.concatenate([corners[ways == 0], *(np.stack(p, axis=1) for p in parts)]),
        rim=np.concatenate([mesh.rim, count[cut] == 1]),
    )
    own = np.arange(n)
    ends = np.concatenate([np.stack([own, own], axis=1), edges[cut]])
    return Refined(finer, ends, np.concatenate(parents))
