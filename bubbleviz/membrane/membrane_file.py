"""The reference surface from a mesh file: checked, oriented, its open boundary as the rim.

By hand because trimesh tells that a mesh is wrong, not which edge, triangle or node is; and its
import takes a quarter of a second, whenever a sensor with a mesh is loaded.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from bubbleviz.errors import InputError
from bubbleviz.files.mesh_reader import read_triangles
from bubbleviz.membrane.mesh import MembraneMesh, area_vectors

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
            f"the membrane is {size:.4g} m wide; is the mesh in millimetres? scale it to metres"
        )
    if size < SMALLEST_M:
        raise InputError(f"the membrane is only {size:.3g} m wide; scale the mesh to metres")


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
            " stands twice; remove duplicate faces"
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
            f" {count[count > 2][0]} triangles; a membrane has at most two: remove the others"
        )
    single = order[begin[count == 1]]
    if not len(single):
        raise InputError("the surface is closed; the rim must be an open boundary: cut it open")
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
            f"{pieces} separate pieces, one at {_place(nodes[triangles[t, 0]])}; keep the membrane"
        )


def _check_one_loop(nodes: np.ndarray, boundary: np.ndarray) -> None:
    """Refuse holes beside the rim, and boundary loops that touch in a node."""
    degree = np.bincount(boundary.ravel(), minlength=len(nodes))
    if degree.max() > 2:
        i = int(degree.argmax())
        raise InputError(f"boundary loops touch at node {i} at {_place(nodes[i])}; close the hole")
    n = len(nodes)
    graph = sparse.coo_array((np.ones(len(boundary)), tuple(boundary.T)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    loops, counts = np.unique(label[boundary[:, 0]], return_counts=True)
    if len(loops) > 1:
        edge = boundary[label[boundary[:, 0]] == loops[counts.argmin()]][0]
        raise InputError(
            f"{len(loops)} boundary loops, the smallest through edge {edge[0]}–{edge[1]} at"
            f" {_place(nodes[edge[0]])}; the rim must be the only one: close the others"
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
        raise InputError("the surface has only one side (a Möbius band); repair the mesh")
    return np.where(kept[:, None], triangles, triangles[:, [0, 2, 1]])


def _check_frame(mesh: MembraneMesh, facing: np.ndarray) -> None:
    """Refuse a mesh that is not in the frame B: rim about z = 0, dome to +z."""
    rim = mesh.nodes[mesh.rim]
    tilt = float(np.degrees(np.arccos(facing[2] / np.linalg.norm(facing))))
    if tilt > 30.0:
        raise InputError(
            f"the rim is tilted {tilt:.0f}° from z = 0; turn the mesh into frame B (+z out)"
        )
    offset, width = float(rim[:, 2].mean()), float(np.ptp(rim[:, :2], axis=0).max())
    if abs(offset) > 0.1 * width:
        raise InputError(f"the rim lies at z = {offset:.4g} m; move the mesh so that it is at 0")
    if mesh.cap_volume() < -1e-3 * width**3:
        raise InputError("the dome points to -z; turn the mesh so that +z points out")


def _place(point: np.ndarray) -> str:
    return f"({point[0]:.4f}, {point[1]:.4f}, {point[2]:.4f}) m"


def _list(indices: np.ndarray) -> str:
    return ", ".join(str(int(i)) for i in indices)
