"""Analytic reference surfaces and the triangle meshes made on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from bubbleviz.errors import InputError
from bubbleviz.files import read_triangles
from bubbleviz.membrane.mesh import MembraneMesh, area_vectors, open_sides, sums_at

# Mesh improvement on a surface: edge flips and tangential smoothing.


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
        centroid = sums_at(flat, np.repeat(moment, 3, axis=0), len(nodes))
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


@dataclass(frozen=True)
class EllipsoidalCap:
    """Cap of an ellipsoid above the plane z = 0, centred on the z axis, apex at +z."""

    rim_semi_axes_m: tuple[float, float]  # (ax, ay), semi-axes of the rim ellipse along x and y, m
    height_m: float  # apex above the rim plane, m
    # vertical semi-axis c of the whole ellipsoid, m; more than half the height. The cap is less
    # than half of the ellipsoid where c > height and more where c < height.
    vertical_semi_axis_m: float

    @classmethod
    def of(
        cls, rim_semi_axes_m: tuple[float, float], height_m: float, c_m: float | None = None
    ) -> EllipsoidalCap:
        """Cap over a rim of given height; c from the rim and height where it is not given.

        Rim and height leave c open. An inflated membrane of uniform tension has the same mean
        curvature everywhere, so c is taken from the spherical cap of that height whose rim
        radius a has 2/a² = 1/ax² + 1/ay²: the apex then has that sphere's mean curvature 1/c,
        and equal semi-axes give the spherical cap itself, c = (a² + h²)/(2h). Within 2 % of
        the c that balances the pressure on the whole cap against the pull at its rim.
        """
        ax, ay = rim_semi_axes_m
        if c_m is None:
            a2 = 2.0 / (ax**-2 + ay**-2)
            c_m = (a2 + height_m**2) / (2.0 * height_m)
        if not c_m > 0.5 * height_m:
            raise InputError(
                f"vertical semi-axis {c_m:g} m is too small; give more than half the height, "
                f"{0.5 * height_m:g} m"
            )
        return cls((ax, ay), height_m, c_m)

    @property
    def semi_axes(self) -> np.ndarray:
        """Semi-axes of the whole ellipsoid, shape (3,), m."""
        c, h = self.vertical_semi_axis_m, self.height_m
        rim = np.sqrt(2.0 * h / c - (h / c) ** 2)  # radius of the rim on the unit sphere
        return np.array([self.rim_semi_axes_m[0] / rim, self.rim_semi_axes_m[1] / rim, c])

    @property
    def centre(self) -> np.ndarray:
        """Centre of the ellipsoid in B, shape (3,), m."""
        return np.array([0.0, 0.0, self.height_m - self.vertical_semi_axis_m])

    @property
    def rim_polar_angle(self) -> float:
        """Polar angle of the rim on the unit sphere that the ellipsoid is scaled from, rad."""
        return float(np.arccos(np.clip(1.0 - self.height_m / self.vertical_semi_axis_m, -1, 1)))

    def point(self, polar: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Points at polar angle (0 at the apex) and azimuth on the unit sphere; (…, 3), m."""
        sine = np.sin(polar)
        unit = np.stack(
            [sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth], axis=-1
        )
        return self.centre + unit * self.semi_axes

    def project(self, points: np.ndarray) -> np.ndarray:
        """Points moved onto the ellipsoid along the line to its centre, shape (k, 3), m."""
        unit = (points - self.centre) / self.semi_axes
        return self.centre + unit / np.linalg.norm(unit, axis=1, keepdims=True) * self.semi_axes


def spherical_cap(rim_radius_m: float, height_m: float) -> EllipsoidalCap:
    """Cap of a sphere: rim radius a and height h, h > a being more than a hemisphere."""
    return EllipsoidalCap.of((rim_radius_m, rim_radius_m), height_m)


def mesh_cap(cap: EllipsoidalCap, nodes: int) -> MembraneMesh:
    """Near-uniform triangle mesh of a cap, with about `nodes` nodes, the same every time.

    Rings of equal spacing along every meridian, each with as many nodes as its share of the
    surface, are triangulated (Delaunay) and smoothed on the surface. Nodes lie on the surface,
    those of the rim on the rim; no direction is preferred.
    """
    rings = _rings(cap, nodes)
    polar, azimuth = np.concatenate(rings, axis=0).T
    # The stereographic map is conformal: Delaunay in this plane is Delaunay on the sphere.
    radius = np.tan(0.5 * polar)
    plane = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=1)
    triangles = _counter_clockwise(plane, Delaunay(plane).simplices.astype(np.int64))
    points = cap.point(polar, azimuth)
    rim = np.zeros(len(points), dtype=bool)
    rim[-len(rings[-1]) :] = True
    points[rim, 2] = 0.0
    triangles = lawson_flips(points, triangles)
    held = rim.copy()
    held[0] = True  # a node at the apex, so that the mesh is as high as the cap
    points, triangles = smooth(points, triangles, held, cap.project)
    return MembraneMesh(nodes=points, triangles=triangles, rim=rim)


def _rings(cap: EllipsoidalCap, nodes: int) -> list[np.ndarray]:
    """Polar angle and azimuth of the nodes, ring by ring from the apex to the rim."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, 721)
    polar = np.linspace(0.0, cap.rim_polar_angle, 257)
    meridians, area, rim_length = _measure(cap, polar, azimuth)
    edge = _edge_length(area, rim_length, nodes)
    count = max(2, round(float(meridians[-1].mean()) / (0.5 * np.sqrt(3.0) * edge)))
    fractions = np.arange(1, count + 1) / count  # of every meridian's length
    levels = np.stack([np.interp(fractions * m[-1], m, polar) for m in meridians.T], axis=1)
    levels[-1] = cap.rim_polar_angle
    steps = np.linalg.norm(np.diff(cap.point(levels, azimuth[None, :]), axis=1), axis=2)
    # The same area for every node: closer together where the rings are far apart.
    weights = steps * (meridians[-1, 1:] + meridians[-1, :-1])
    weights[-1] = steps[-1]
    lengths = steps.sum(axis=1)
    sizes = np.maximum(np.rint(lengths * ((nodes - 1) / lengths.sum())).astype(int), 3)
    golden = 0.6180339887498949 * np.arange(count) % 1.0  # no seam where every ring starts
    golden[-1] = 0.0
    rings = [np.zeros((1, 2))]
    for size, offset, level, weight in zip(sizes, golden, levels, weights, strict=True):
        share = np.concatenate([[0.0], weight.cumsum() / weight.sum()])
        at = np.interp((np.arange(size) + offset) / size, share, azimuth)
        rings.append(np.stack([np.interp(at, azimuth, level), at], axis=1))
    return rings


def _measure(
    cap: EllipsoidalCap, polar: np.ndarray, azimuth: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Length along every meridian (polar × azimuth), area of the cap and length of its rim."""
    points = cap.point(polar[:, None], azimuth[None, :])
    along = np.linalg.norm(np.diff(points, axis=0), axis=2)
    around = np.linalg.norm(np.diff(points, axis=1), axis=2)
    cells = 0.25 * (along[:, 1:] + along[:, :-1]) * (around[1:] + around[:-1])
    meridians = np.concatenate([np.zeros((1, len(azimuth))), along.cumsum(axis=0)])
    return meridians, float(cells.sum()), float(around[-1].sum())


def _edge_length(area: float, rim_length: float, nodes: int) -> float:
    """Edge length at which equilateral triangles over `area` have about `nodes` nodes."""
    # nodes = area / (√3/2 d²) + rim/(2 d): a rim node owns half a cell
    linear, constant = 0.5 * rim_length, area / (0.5 * np.sqrt(3.0))
    return float((linear + np.sqrt(linear**2 + 4.0 * nodes * constant)) / (2.0 * nodes))


def _counter_clockwise(plane: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Triangles of a plane triangulation, counter-clockwise, without degenerate ones."""
    a, b, c = (plane[triangles[:, k]] for k in range(3))
    e, f = b - a, c - a
    area = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    triangles = np.where(area[:, None] < 0.0, triangles[:, [0, 2, 1]], triangles)
    return triangles[np.abs(area) > 1e-12 * np.abs(area).max()]


# A finer mesh of the same facets, everywhere or where it matters.


class Refined(NamedTuple):
    """A finer mesh and where its nodes are on the coarser one."""

    mesh: MembraneMesh  # the coarser one's nodes come first
    # (k, 2), or (k, 4) if refined twice: int, nodes of the coarser mesh whose mean each node is,
    # all the same for its own
    ends: np.ndarray
    parent: np.ndarray  # (m,) int, triangle of the coarser mesh that each triangle is part of

    def values(self, coarse: np.ndarray) -> np.ndarray:
        """Values on the coarser nodes (n, …), interpolated linearly to the finer ones."""
        return midway(coarse, self.ends)

    def again(self, chosen: np.ndarray) -> Refined:
        """With some of its triangles (m,) bool cut into four once more."""
        finer = refinement(self.mesh, chosen)
        ends = self.ends[finer.ends].reshape(len(finer.ends), -1)
        return Refined(finer.mesh, ends, self.parent[finer.parent])


def midway(coarse: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Means of the values (n, …) of the `ends` (k, 2) or (k, 4) of each node, (k, …)."""
    values: np.ndarray = coarse[ends].mean(axis=1)
    return values


def part_of(mesh: MembraneMesh, triangles: np.ndarray) -> tuple[np.ndarray, MembraneMesh]:
    """Nodes (k,) of some triangles (j,) of a mesh, and the mesh that these are."""
    nodes, corners = np.unique(mesh.triangles[triangles], return_inverse=True)
    return nodes, MembraneMesh(mesh.nodes[nodes], corners.reshape(-1, 3), mesh.rim[nodes])


def refined_part(mesh: MembraneMesh, inside: np.ndarray, chosen: np.ndarray) -> Refined:
    """Part of a mesh with some of its triangles cut into four.

    Parameters
    ----------
    mesh : MembraneMesh
    inside, chosen : (m,) bool array
        Triangles of the part, and those to cut. Where the part ends its nodes are held.
    """
    triangles = np.flatnonzero(inside)
    nodes, part = part_of(mesh, triangles)
    for ends in open_sides(part.triangles):
        part.rim[ends] = True
    finer = refinement(part, chosen[triangles])
    return Refined(finer.mesh, nodes[finer.ends], triangles[finer.parent])


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


# The reference surface from a mesh file: checked, oriented, its open boundary as the rim.
#
# Not by trimesh, which says that a mesh is wrong, but not which edge, triangle or node; and its
# import takes a quarter of a second whenever a sensor with a mesh is loaded.


LARGEST_M = 1.0  # of the mesh's box, m: more is in millimetres
SMALLEST_M = 2e-3  # of the mesh's box, m


def load_membrane(path: str | Path) -> MembraneMesh:
    """Membrane mesh from a PLY, OBJ, STL or VTK file in metres and frame B.

    The open boundary is the rim, held at z ≈ 0 (it need not be exactly plane; the cap volume
    is that above z = 0). Triangles are turned so that normals point out, to +z.

    Raises InputError: one line with the file, the edge, triangle or node at fault, and what to do.
    """
    nodes, triangles = read_triangles(path)
    try:
        return membrane_from_triangles(nodes, triangles)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def membrane_from_triangles(nodes: np.ndarray, triangles: np.ndarray) -> MembraneMesh:
    """Checked and oriented membrane mesh; see `load_membrane`."""
    _check_size(nodes)
    _check_triangles(nodes, triangles)
    first, second, boundary = _edges(nodes, triangles)
    _check_connected(nodes, triangles, first, second)
    _check_one_loop(nodes, boundary)
    triangles = _oriented(triangles, first, second)
    facing = area_vectors(nodes, triangles).sum(axis=0)  # of the rim's opening
    if facing[2] < 0.0:
        triangles, facing = triangles[:, [0, 2, 1]], -facing
    rim = np.zeros(len(nodes), dtype=bool)
    rim[boundary] = True
    mesh = MembraneMesh(nodes=nodes, triangles=np.ascontiguousarray(triangles), rim=rim)
    _check_frame(mesh, facing)
    return mesh


def _check_size(nodes: np.ndarray) -> None:
    size = float(np.ptp(nodes, axis=0).max())
    if size > LARGEST_M:
        raise InputError(
            f"the membrane is {size:.4g} m wide, above {LARGEST_M:g} m; scale the mesh to metres"
        )
    if size < SMALLEST_M:
        raise InputError(
            f"the membrane is only {size:.3g} m wide, below {SMALLEST_M:g} m; scale the mesh to "
            "metres"
        )


def _check_triangles(nodes: np.ndarray, triangles: np.ndarray) -> None:
    """Raise on degenerate and duplicate triangles."""
    corners = nodes[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    double = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    longest = (edges**2).sum(axis=2).max(axis=1)
    flat = np.flatnonzero(double <= 1e-6 * longest)
    if len(flat):
        t = flat[0]
        raise InputError(
            f"triangle {t} (nodes {_list(triangles[t])}) at {_place(corners[t].mean(axis=0))} has"
            " no area; remove degenerate triangles"
        )
    _, index, count = np.unique(
        np.sort(triangles, axis=1), axis=0, return_index=True, return_counts=True
    )
    if (count > 1).any():
        t = index[count > 1][0]
        raise InputError(
            f"the triangle with nodes {_list(triangles[t])} at {_place(corners[t].mean(axis=0))}"
            " occurs twice; remove duplicate faces"
        )


def _edges(nodes: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half-edges (3 t + corner) paired across each inner edge, and the boundary edges (k, 2)."""
    n = len(nodes)
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    key = np.minimum(start, end) * n + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, begin, count = np.unique(key[order], return_index=True, return_counts=True)
    if (count > 2).any():
        edge = order[begin[count > 2][0]]
        i, j = sorted((int(start[edge]), int(end[edge])))
        raise InputError(
            f"edge {i}–{j} from {_place(nodes[i])} to {_place(nodes[j])} belongs to"
            f" {count[count > 2][0]} triangles; remove all but two of them"
        )
    single = order[begin[count == 1]]
    if not len(single):
        raise InputError("the surface is closed; cut it open at the rim")
    pairs = begin[count == 2]
    return order[pairs], order[pairs + 1], np.stack([start[single], end[single]], axis=1)


def _check_connected(
    nodes: np.ndarray, triangles: np.ndarray, first: np.ndarray, second: np.ndarray
) -> None:
    m = len(triangles)
    graph = sparse.coo_array((np.ones(len(first)), (first // 3, second // 3)), shape=(m, m))
    pieces, label = connected_components(graph, directed=False)
    if pieces > 1:
        t = int(np.flatnonzero(label == np.bincount(label).argmin())[0])
        raise InputError(
            f"{pieces} separate pieces, one at {_place(nodes[triangles[t, 0]])}; delete all but "
            "the membrane"
        )


def _check_one_loop(nodes: np.ndarray, boundary: np.ndarray) -> None:
    """Refuse holes other than the rim, and boundary loops that touch in a node."""
    degree = np.bincount(boundary.ravel(), minlength=len(nodes))
    if degree.max() > 2:
        i = int(degree.argmax())
        raise InputError(
            f"boundary loops touch at node {i} at {_place(nodes[i])}; close all holes but the rim"
        )
    n = len(nodes)
    graph = sparse.coo_array((np.ones(len(boundary)), tuple(boundary.T)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    loops, counts = np.unique(label[boundary[:, 0]], return_counts=True)
    if len(loops) > 1:
        edge = boundary[label[boundary[:, 0]] == loops[counts.argmin()]][0]
        raise InputError(
            f"{len(loops)} boundary loops, the smallest through edge {edge[0]}–{edge[1]} at"
            f" {_place(nodes[edge[0]])}; close all holes but the rim"
        )


def _oriented(triangles: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Triangles turned to run the same way round.

    Every triangle stands in a graph twice, kept and turned; neighbours that agree link kept to
    kept, others kept to turned. The half that triangle 0 is in is the consistent choice.
    """
    m = len(triangles)
    flat = triangles.ravel()
    agree = flat[first] != flat[second]  # half-edges of consistent neighbours run opposite ways
    t, s = first // 3, second // 3
    rows = np.concatenate([t, t + m])
    cols = np.concatenate([np.where(agree, s, s + m), np.where(agree, s + m, s)])
    graph = sparse.coo_array((np.ones(len(rows)), (rows, cols)), shape=(2 * m, 2 * m))
    _, label = connected_components(graph, directed=False)
    kept = label[:m] == label[0]
    if (kept & (label[m:] == label[0])).any():
        raise InputError("the surface is not orientable (a Möbius band); repair the mesh")
    return np.where(kept[:, None], triangles, triangles[:, [0, 2, 1]])


def _check_frame(mesh: MembraneMesh, facing: np.ndarray) -> None:
    """Refuse a mesh that is not in the frame B: rim about z = 0, dome to +z."""
    rim = mesh.nodes[mesh.rim]
    tilt = float(np.degrees(np.arccos(facing[2] / np.linalg.norm(facing))))
    if tilt > 30.0:
        raise InputError(
            f"the rim is tilted {tilt:.0f}° from z = 0; rotate the mesh so that its rim "
            "lies in z = 0"
        )
    offset, width = float(rim[:, 2].mean()), float(np.ptp(rim[:, :2], axis=0).max())
    if abs(offset) > 0.1 * width:
        raise InputError(
            f"the rim lies at z = {offset:.4g} m; move the mesh so that its rim lies at z = 0"
        )
    if mesh.cap_volume() < -1e-3 * width**3:
        raise InputError("the dome points to -z; turn the mesh so that the dome points to +z")


def _place(point: np.ndarray) -> str:
    return f"({point[0]:.4f}, {point[1]:.4f}, {point[2]:.4f}) m"


def _list(indices: np.ndarray) -> str:
    return ", ".join(str(int(i)) for i in indices)
