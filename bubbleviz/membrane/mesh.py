"""The triangle mesh of the reference configuration and its geometry."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from bubbleviz.errors import InputError
from bubbleviz.membrane.assembly import Assembly


@dataclass(frozen=True)
class MembraneMesh:
    """Reference configuration S0 in the bubble frame B."""

    nodes: np.ndarray  # (n, 3), node positions x0 in m
    # (m, 3) int, node indices, counter-clockwise seen from outside (normals point out of the
    # sensor)
    triangles: np.ndarray
    rim: np.ndarray  # (n,) bool, nodes clamped at the rim, where u = 0

    def __getstate__(self) -> dict[str, np.ndarray]:
        """Leave out what can be recomputed, for other processes."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def facet_vectors(self) -> np.ndarray:
        """Area vectors of the triangles (area × unit normal), shape (m, 3), m²."""
        return area_vectors(self.nodes, self.triangles)

    @cached_property
    def facet_areas(self) -> np.ndarray:
        """Triangle areas, shape (m,), m²."""
        return np.linalg.norm(self.facet_vectors, axis=1)

    @cached_property
    def areas(self) -> np.ndarray:
        """Lumped nodal areas A, one third of the incident area each, shape (n,), m² (Eq. 4)."""
        weights = np.repeat(self.facet_areas / 3.0, 3)
        return np.bincount(self.triangles.ravel(), weights, minlength=len(self.nodes))

    @cached_property
    def normals(self) -> np.ndarray:
        """Area-weighted unit node normals n̂0, outward, shape (n, 3)."""
        vectors = np.repeat(self.facet_vectors, 3, axis=0)
        sums = sums_at(self.triangles.ravel(), vectors, len(self.nodes))
        return sums / np.linalg.norm(sums, axis=1, keepdims=True)

    @cached_property
    def free(self) -> np.ndarray:
        """Indices of the nodes that move (not on the rim)."""
        return np.flatnonzero(~self.rim)

    @cached_property
    def corners(self) -> np.ndarray:
        """The triangles by corner, (3, m): contiguous rows for fast access to one corner of all."""
        return np.ascontiguousarray(self.triangles.T)

    @cached_property
    def inner_assembly(self) -> Assembly:
        """Assembly of matrices over the free nodes."""
        return Assembly.of(self.corners, self.free, len(self.nodes))

    @cached_property
    def full_assembly(self) -> Assembly:
        """Assembly of matrices over all nodes."""
        return Assembly.of(self.corners, np.arange(len(self.nodes)), len(self.nodes))

    @cached_property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """A node and its neighbour for both directions of every edge, (2e,) int each, sorted."""
        count = len(self.nodes)
        start, end = self.triangles.ravel(), np.roll(self.triangles, -1, axis=1).ravel()
        pairs = np.unique(np.concatenate([start * count + end, end * count + start]))
        node, neighbour = np.divmod(pairs, count)
        return node, neighbour

    @cached_property
    def rings(self) -> np.ndarray:
        """Each node and its neighbours, (d, n) int: one column per node, padded with the node."""
        count, (node, neighbour) = len(self.nodes), self.neighbours
        place = 1 + np.arange(len(node)) - np.searchsorted(node, np.arange(count))[node]
        rings = np.tile(np.arange(count), (1 + place.max(initial=0), 1))
        rings[place, node] = neighbour
        return rings

    @cached_property
    def angles(self) -> np.ndarray:
        """Interior angles of every triangle, shape (m, 3), rad."""
        corners = self.nodes[self.triangles]
        edges = np.roll(corners, -1, axis=1) - corners
        out, back = edges, -np.roll(edges, 1, axis=1)
        cosine = np.einsum("ijk,ijk->ij", out, back)
        sine = np.linalg.norm(np.cross(out, back), axis=2)
        return np.arctan2(sine, cosine)

    @cached_property
    def rim_lengths(self) -> np.ndarray:
        """Length of the rim represented by each node, shape (n,), m; 0 off the rim."""
        start, end = open_sides(self.triangles)
        half = 0.5 * np.linalg.norm(self.nodes[start] - self.nodes[end], axis=1)
        count = len(self.nodes)
        return np.bincount(start, half, minlength=count) + np.bincount(end, half, minlength=count)

    @cached_property
    def disc(self) -> np.ndarray:
        """Harmonic map of the nodes to the unit disc, (n, 2).

        The rim goes to the circle by its length, with azimuths kept in the mean, so that all meshes
        of a surface have nearly the same map.

        Raises InputError: triangles are turned over, which badly shaped ones cause.
        """
        loop = _rim_loop(self)
        rim = self.nodes[loop]
        sides = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1)
        angle = 2.0 * np.pi * (np.cumsum(sides) - sides) / sides.sum()
        azimuth = np.arctan2(rim[:, 1], rim[:, 0])
        angle += np.angle(np.sum((sides + np.roll(sides, 1)) * np.exp(1j * (azimuth - angle))))
        disc = np.empty((len(self.nodes), 2))
        disc[loop] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        inner = np.setdiff1d(np.arange(len(self.nodes)), loop)
        rows = cotangent_laplacian(self)[inner]
        disc[inner] = splu(rows[:, inner].tocsc()).solve(-(rows[:, loop] @ disc[loop]))
        edges = disc[self.triangles[:, 1:]] - disc[self.triangles[:, :1]]
        if not (np.linalg.det(edges) > 0.0).all():
            raise InputError(
                "membrane mesh: triangles are too distorted to map the mesh to a disc; remesh it "
                "evenly, or identify the sensor again"
            )
        return disc

    @property
    def edge_length(self) -> float:
        """Edge in m of the equilateral triangle of mean area: the resolution of the mesh."""
        return float(np.sqrt(self.facet_areas.mean() * 4.0 / np.sqrt(3.0)))

    def deformed(self, displacement: np.ndarray) -> np.ndarray:
        """Nodes moved by a displacement (n, 3), or by u (n,) along n̂0 (Eq. 1); (n, 3), m."""
        if displacement.ndim == 2:
            return self.nodes + displacement
        return self.nodes + displacement[:, None] * self.normals

    def cap_volume(self, displacement: np.ndarray | None = None) -> float:
        """Signed volume in m³ between the (deformed) surface and the rim plane z = 0 (Eq. 7).

        Exact for the triangle mesh whatever its shape, as long as the rim lies in the plane: by
        the divergence theorem with the field (0, 0, z) the plane itself contributes nothing.
        """
        nodes = self.nodes if displacement is None else self.deformed(displacement)
        a, b, c = nodes[self.triangles.T, 2]
        return float(np.sum(area_vectors(nodes, self.triangles)[:, 2] * (a + b + c) / 3.0))


def triangles_across(triangles: np.ndarray) -> np.ndarray:
    """Triangle (m, 3) across the side opposite each corner; −1 at the rim."""
    n = int(triangles.max()) + 1
    start, end = np.roll(triangles, -1, axis=1).ravel(), np.roll(triangles, -2, axis=1).ravel()
    key = start * n + end
    order = np.argsort(key)
    there = np.minimum(np.searchsorted(key[order], end * n + start), len(key) - 1)
    found = order[there]
    across = np.where(key[found] == end * n + start, found // 3, -1)
    return across.reshape(-1, 3)


def open_sides(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and end (k,) of each side that only one of triangles (m, 3) has, in its direction."""
    triangle, corner = np.nonzero(triangles_across(triangles) < 0)
    return triangles[triangle, (corner + 1) % 3], triangles[triangle, (corner + 2) % 3]


def _rim_loop(mesh: MembraneMesh) -> np.ndarray:
    """Nodes of the open boundary in their order, counter-clockwise seen from outside."""
    starts, ends = open_sides(mesh.triangles)
    after = np.full(len(mesh.nodes), -1)
    after[starts] = ends
    loop = [int(starts[0])]
    while after[loop[-1]] != loop[0]:
        loop.append(int(after[loop[-1]]))
    return np.array(loop)


def cotangent_laplacian(mesh: MembraneMesh) -> sparse.csr_array:
    """P1 stiffness matrix L of −∇² on the mesh, n×n, symmetric, dimensionless.

    The stiffness of the membrane is K = γ0 L. It is positive definite only on the free nodes:
    eliminate the rim's rows and columns before factorising.
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


def sums_at(nodes: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, d) at nodes of values (k, d), each given with the number (k,) of its node."""
    return np.stack([np.bincount(nodes, each, minlength=count) for each in values.T], axis=1)


def faces_from(local: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Cross products b×c, c×a and a×b of the corners of triangles (m, 3), (m, 3, 3)."""
    second, third = (  # `take`: a third of the time of indexing
        local.take(triangles[:, turned].ravel(), axis=0) for turned in ([1, 2, 0], [2, 0, 1])
    )
    return cross(second, third).reshape(-1, 3, 3)


def area_vectors(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area times unit normal of triangles (m, 3) between nodes (n, 3), (m, 3), m²."""
    a, b, c = (nodes.take(triangles[:, k], axis=0) for k in range(3))
    return 0.5 * cross(b - a, c - a)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products along the last axis, (…, 3); several times faster than `np.cross`."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[..., k] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return out


# Sets of nodes on the graph of a mesh's edges, given as `MembraneMesh.rings`.


def grown(rings: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Nodes (n,) bool in or next to a set of nodes."""
    wider = mask.copy()
    wider[rings.take(np.flatnonzero(mask), axis=1)] = True
    return wider


def connected_parts(rings: np.ndarray, mask: np.ndarray) -> tuple[int, np.ndarray]:
    """Number of connected parts of a set of nodes (n,) bool, and the part of each of its nodes."""
    nodes, lowest = np.flatnonzero(mask), np.arange(len(mask))
    around = rings[:, nodes]
    around = np.where(mask[around], around, nodes)
    while True:  # lowest node of each part, propagated by neighbours and by that node
        lower = lowest[around].min(axis=0, initial=len(mask))
        if (lower == lowest[nodes]).all():  # `np.array_equal` takes several times as long
            break
        lowest[nodes] = lower
        lowest[nodes] = lowest[lower]
    first = nodes[lower == nodes]
    return len(first), np.searchsorted(first, lower)


def parts_with(rings: np.ndarray, some: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Connected parts of a set of nodes (n,) bool that contain one of `some` (n,) bool."""
    count, part = connected_parts(rings, mask)
    chosen = np.bincount(part, some[mask], minlength=count) > 0.0
    kept = mask.copy()
    kept[mask] = chosen[part]
    return kept


def adjacency(rings: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Which of some nodes (k,) share an edge, (k, k) bool."""
    number = np.full(rings.shape[1], -1)
    number[nodes] = np.arange(len(nodes))
    there = number[rings[:, nodes]]
    adjacent = np.zeros((len(nodes), len(nodes)), bool)
    adjacent[there[there >= 0], np.nonzero(there >= 0)[1]] = True
    np.fill_diagonal(adjacent, False)
    return adjacent


def dense_part(matrix: sparse.csr_array, nodes: np.ndarray) -> np.ndarray:
    """Rows and columns `nodes` (k,) of a sparse matrix, (k, k).

    SciPy's own indexing takes several times as long on matrices this small.
    """
    number = np.full(matrix.shape[1], -1)
    number[nodes] = np.arange(len(nodes))
    starts = matrix.indptr[nodes]
    count = matrix.indptr[nodes + 1] - starts
    row = np.repeat(np.arange(len(nodes)), count)
    entry = np.arange(len(row)) + np.repeat(starts - np.cumsum(count) + count, count)
    column = number[matrix.indices[entry]]
    inside = column >= 0
    part = np.zeros((len(nodes), len(nodes)))
    part[row[inside], column[inside]] = matrix.data[entry[inside]]
    return part


# The line on a triangle mesh where a nodal field has a level.


def level_line(
    points: np.ndarray,  # (n, d), positions, or these with other fields
    corners: np.ndarray,  # (3, m) int, triangles by corner
    field: np.ndarray,  # (n,), linear on each triangle
    level: float = 0.0,
) -> np.ndarray:
    """Straight pieces of the line, one in each triangle that it crosses, (k, 2, d)."""
    above = field - level
    inside = (above > 0.0).take(corners)
    count = inside.sum(axis=0)
    cut = np.flatnonzero((count == 1) | (count == 2))
    # Rotate each cut triangle so that its first corner is the only one on its side.
    alone = np.argmax(inside[:, cut] == (count[cut] == 1), axis=0)
    a, b, c = (corners[(alone + k) % 3, cut] for k in range(3))
    start, height = points.take(a, axis=0), above[a]
    pieces = np.empty((len(cut), 2, points.shape[1]))
    for end, k in enumerate((b, c)):
        share = height / (height - above[k])
        pieces[:, end] = start + share[:, None] * (points.take(k, axis=0) - start)
    return pieces
