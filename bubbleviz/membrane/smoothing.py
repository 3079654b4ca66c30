"""Mesh improvement on a surface: edge flips and tangential smoothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bubbleviz.membrane.mesh import area_vectors


def lawson_flips(
    nodes: np.ndarray,  # (n, 3)
    triangles: np.ndarray,  # (m, 3) int, consistently oriented; the orientation is kept
    passes: int = 30,
) -> np.ndarray:
    """Triangles with edges flipped until each is locally Delaunay (opposite angles sum to ≤ π)."""
    triangles = triangles.copy()
    for _ in range(passes):
        first, second = _bad_edges(nodes, triangles)
        if not len(first):
            break
        _flip(triangles, first, second)
    return triangles


def smooth(
    nodes: np.ndarray,  # (n, 3), m
    triangles: np.ndarray,  # (m, 3) int
    fixed: np.ndarray,  # (n,) bool, nodes that stay (the rim)
    project: Callable[[np.ndarray], np.ndarray],  # puts points (k, 3) back on the surface
    iterations: int = 16,  # sweeps; edges are flipped to Delaunay in between
) -> tuple[np.ndarray, np.ndarray]:
    """Move free nodes to the area-weighted centroid of their triangles, on the surface."""
    free = np.flatnonzero(~fixed)
    nodes = nodes.copy()
    for _ in range(iterations):
        corners = nodes[triangles]
        area = np.linalg.norm(area_vectors(nodes, triangles), axis=1)
        moment = area[:, None] * corners.mean(axis=1)
        flat = triangles.ravel()
        weight = np.bincount(flat, np.repeat(area, 3), minlength=len(nodes))
        centroid = np.stack(
            [np.bincount(flat, np.repeat(moment[:, k], 3), minlength=len(nodes)) for k in range(3)],
            axis=1,
        )
        nodes[free] = project(centroid[free] / weight[free, None])
        triangles = lawson_flips(nodes, triangles)
    return nodes, triangles


def _bad_edges(nodes: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half-edges (flat index 3 t + corner opposite) of the pairs that are not Delaunay."""
    n, m = len(nodes), len(triangles)
    start = triangles[:, [1, 2, 0]].ravel()
    end = triangles[:, [2, 0, 1]].ravel()
    key = np.minimum(start, end) * n + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    key = key[order]
    shared = np.flatnonzero(key[1:] == key[:-1])
    first, second = order[shared], order[shared + 1]
    cotangent = _cotangents(nodes, triangles).ravel()
    excess = cotangent[first] + cotangent[second]
    bad = np.flatnonzero(excess < -1e-9)
    if not len(bad):
        return bad, bad
    # One flip per triangle and pass: the worst edge of both its triangles goes first.
    bad = bad[np.argsort(excess[bad], kind="stable")]
    rank = np.arange(len(bad))
    best = np.full(m, len(bad))
    np.minimum.at(best, first[bad] // 3, rank)
    np.minimum.at(best, second[bad] // 3, rank)
    chosen = bad[(best[first[bad] // 3] == rank) & (best[second[bad] // 3] == rank)]
    return first[chosen], second[chosen]


def _cotangents(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Cotangent of every corner, shape (m, 3)."""
    corners = nodes[triangles]
    edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]  # opposite corner 0, 1, 2
    double = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    dots = -np.einsum("ijk,ijk->ij", edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
    return dots / np.maximum(double, 1e-300)[:, None]


def _flip(triangles: np.ndarray, first: np.ndarray, second: np.ndarray) -> None:
    """Replace the shared edge of each pair of triangles by the other diagonal, in place."""
    t, s = first // 3, second // 3
    i, j = first % 3, second % 3
    apex, left, right = (triangles[t, (i + k) % 3] for k in range(3))
    other = triangles[s, j]
    triangles[t] = np.stack([apex, left, other], axis=1)
    triangles[s] = np.stack([apex, other, right], axis=1)
