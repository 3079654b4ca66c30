"""Triangle meshes from PLY, OBJ, STL and VTK files, without change of unit.

VTK is only imported for its own formats, as it is installed with the window alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bubbleviz.errors import InputError
from bubbleviz.files.reading import as_input_error, exists

# PLY files: any element and property order, ASCII or binary of either byte order.
#
# Other readers refuse valid files: trimesh binary files that mix triangles with other polygons, VTK
# faces before vertices, Open3D x, y, z in another order. Trimesh also accepts truncated ASCII
# files, logs on stderr, and takes a quarter of a second to import.


_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_FACES = ("vertex_indices", "vertex_index")

_Property = tuple[str, np.dtype, np.dtype | None]
"""Name, type, and for a list the type of its length."""
_Element = tuple[str, int, list[_Property]]  # name, number of rows, properties
_Columns = Mapping[str, np.ndarray | list[np.ndarray]]
"""Values of each row by property: one value, or the values of a list."""


def read_ply(path: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """Vertices (n, 3) and polygons, each an int array grouped by size (k, corners).

    Raises ValueError: not a PLY, truncated, or without vertices and faces.
    """
    header, body = _split(path.read_bytes())
    is_ascii, elements = _parse_header(header)
    if is_ascii:
        body = np.array(body.split(), dtype=np.float64).tobytes()
    vertices, polygons = None, None
    at = 0
    for name, count, properties in elements:
        columns, at = _read_element(properties, count, body, at)
        if name == "vertex":
            missing = [axis for axis in "xyz" if axis not in columns]
            if missing:
                raise ValueError(f"vertices without {missing[0]}")
            vertices = np.hstack([np.reshape(columns[a], (-1, 1)) for a in "xyz"]).astype(float)
        if name == "face":
            polygons = next((columns[key] for key in _FACES if key in columns), None)
    if vertices is None or polygons is None:
        raise ValueError("no vertices, or no faces with vertex_indices")
    sizes = np.array([len(p) for p in polygons], dtype=int)
    groups = [
        np.array([polygons[i] for i in np.flatnonzero(sizes == s)], dtype=np.int64)
        for s in np.unique(sizes[sizes > 2])
    ]
    return vertices, groups


def _split(data: bytes) -> tuple[list[list[str]], bytes]:
    end = data.find(b"end_header")
    newline = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or newline < 0:
        raise ValueError("no PLY header")
    text = data[:end].decode("ascii", errors="replace")
    return [line.split() for line in text.splitlines()], data[newline + 1 :]


def _parse_header(lines: list[list[str]]) -> tuple[bool, list[_Element]]:
    """Whether the file is ASCII (then all values are read as doubles), and its elements."""
    formats = [_ORDERS.get(words[1]) for words in lines if words[0:1] == ["format"] and words[1:]]
    if not formats or formats[0] is None:
        raise ValueError("the format line of its header is missing or unknown")
    order, elements = formats[0], list[_Element]()
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and elements:
            is_list = words[1:2] == ["list"]
            kinds = words[1 + is_list : -1]
            if len(kinds) != 1 + is_list or any(kind not in _TYPES for kind in kinds):
                raise ValueError(f"unknown property: {' '.join(words)}")
            *length, kind = [np.dtype(order + _TYPES[kind] if order else "f8") for kind in kinds]
            elements[-1][2].append((words[-1], kind, length[0] if length else None))
    return order == "", elements


def _read_element(
    properties: list[_Property], count: int, body: bytes, at: int
) -> tuple[_Columns, int]:
    """Columns of an element and its end; all rows at once if they have equal lengths."""
    first, _ = _read_rows(properties, min(count, 1), body, at)
    if count < 1 or not properties:
        return first, at
    row = np.dtype(
        [
            item
            for name, kind, length in properties
            for item in (
                *([(f"#{name}", length)] if length else []),
                (name, kind, (len(first[name][0]),)),
            )
        ]
    )
    if count <= (len(body) - at) // row.itemsize:
        table = np.frombuffer(body, row, count, at)
        if all((table[f"#{p[0]}"] == len(first[p[0]][0])).all() for p in properties if p[2]):
            return {name: table[name] for name in first}, at + count * row.itemsize
    return _read_rows(properties, count, body, at)


def _read_rows(
    properties: list[_Property], count: int, body: bytes, at: int
) -> tuple[dict[str, list[np.ndarray]], int]:
    """Columns read row by row, for lists of different lengths, and the end of the element."""
    rows: dict[str, list[np.ndarray]] = {name: [] for name, _, _ in properties}
    for _ in range(count):
        for name, kind, length in properties:
            size = 1
            if length:
                stored = _values(body, length, 1, at)[0]
                size = int(stored)
                if size != stored:
                    raise ValueError(f"a list has the length {stored}, not a whole number")
                at += length.itemsize
            rows[name].append(_values(body, kind, size, at))
            at += size * kind.itemsize
    return rows, at


def _values(body: bytes, kind: np.dtype, count: int, at: int) -> np.ndarray:
    if not 0 <= count <= (len(body) - at) // kind.itemsize:
        raise ValueError("the file is truncated")
    return np.frombuffer(body, kind, count, at)


_MAX_COORDINATE = 1e9  # in the file's unit, so that squared distances are accurate
_MAX_DUPLICATES = 64  # average number of vertices within the merge distance; chosen
_STL_HEAD = 84  # bytes before the first triangle
_STL_FACET = np.dtype([("normal", "<f4", 3), ("vertices", "<f4", (3, 3)), ("attribute", "<u2")])
SUFFIXES = (".ply", ".obj", ".stl", ".vtk", ".vtp")


def read_triangles(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and triangles (m, 3) of a mesh file, in the file's own unit.

    Polygons are triangulated, and coinciding vertices (STL has three per triangle) merged.

    Raises InputError: no such file, another format, unreadable, without triangles, or with NaN
    coordinates.
    """
    path = Path(path)
    if not exists(path) or not path.is_file():
        raise InputError(
            f"{path}: no such mesh file, or no access to it; check path and permissions"
        )
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: unknown mesh format; export one of {', '.join(SUFFIXES)}")
    with as_input_error(path, "the mesh", "export it again"):
        vertices, triangles = _read(path)
        if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            raise ValueError("a triangle refers to a missing vertex")
    if not len(triangles):
        raise InputError(f"{path}: contains no triangles; export a surface mesh")
    wrong = np.flatnonzero(~(np.abs(vertices) < _MAX_COORDINATE).all(axis=1))
    if len(wrong):
        raise InputError(
            f"{path}: a coordinate of vertex {wrong[0]} (from 0) is not finite or beyond ±10⁹; "
            "repair or rescale the mesh"
        )
    with as_input_error(
        path, "the mesh", "merge close vertices, remove stray ones and export it again"
    ):
        return _merge(vertices, triangles)


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Polygons of the file, triangulated."""
    other = {".obj": _read_obj, ".stl": _read_stl, ".vtk": _read_vtk, ".vtp": _read_vtk}
    if (read := other.get(path.suffix.lower())) is not None:
        return read(path)
    vertices, polygons = read_ply(path)
    fans = [
        np.stack([p[:, 0], p[:, k], p[:, k + 1]], axis=1)
        for p in polygons
        for k in range(1, p.shape[1] - 1)
    ]
    return vertices, np.concatenate(fans) if fans else np.zeros((0, 3), dtype=np.int64)


def _read_stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Binary or ASCII STL: three separate vertices per triangle."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) == _STL_HEAD + count * _STL_FACET.itemsize:
        vertices = np.frombuffer(data, _STL_FACET, count, _STL_HEAD)["vertices"]
    elif data.lstrip().startswith(b"solid"):
        words = [line.split() for line in data.splitlines()]
        vertices = np.array([each[1:4] for each in words if each[:1] == [b"vertex"]], np.float64)
    else:
        raise ValueError(f"not ASCII, and {len(data)} bytes do not match {count} triangles")
    with np.errstate(invalid="ignore"):  # NaN, which is refused later
        vertices = vertices.astype(np.float64).reshape(-1, 3)
    if len(vertices) % 3:
        raise ValueError("the number of vertices is not a multiple of three")
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an OBJ, polygons as fans; other content is ignored."""
    vertices, triangles = list[list[float]](), list[tuple[int, int, int]]()
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            named = [int(word.partition("/")[0]) for word in words[1:]]
            # counted from 1, or backwards from the last vertex
            corners = [k - 1 if k > 0 else len(vertices) + k for k in named]
            triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
    if any(len(vertex) < 3 for vertex in vertices):
        raise ValueError("a vertex has fewer than three coordinates")
    return np.array(vertices).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3)


def _read_vtk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """VTK's formats by VTK, which is installed with the window."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter

    errors: list[str] = []
    reader = _vtk_reader(path)
    for emitter in (reader, reader.GetExecutive()):  # VTK prints errors without an observer
        emitter.AddObserver("ErrorEvent", lambda *_: errors.append("damaged"))
        emitter.AddObserver("WarningEvent", lambda *_: None)
    reader.SetFileName(str(path))
    reader.Update()
    surface = reader.GetOutput()
    if errors or not hasattr(surface, "GetPolys"):
        raise ValueError("damaged, or no VTK PolyData")
    split = vtkTriangleFilter()
    split.SetInputData(surface)
    split.PassLinesOff()
    split.PassVertsOff()
    split.Update()
    data = split.GetOutput()
    if not data.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    vertices = vtk_to_numpy(data.GetPoints().GetData()).astype(np.float64)
    flat = vtk_to_numpy(data.GetPolys().GetConnectivityArray())
    return vertices, flat.astype(np.int64).reshape(-1, 3)


def _vtk_reader(path: Path) -> Any:
    with path.open("rb") as file:
        is_xml = file.read(64).lstrip().startswith(b"<")
    if is_xml:
        from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

        return vtkXMLPolyDataReader()
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader

    return vtkPolyDataReader()


def _merge(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge vertices closer than 1e-7 of the mesh's size, and drop unused ones; keeps the order."""
    radius = 1e-7 * float(np.ptp(vertices, axis=0).max())
    points, point = np.unique(vertices, axis=0, return_inverse=True)
    tree = cKDTree(points)
    if tree.count_neighbors(tree, radius) > _MAX_DUPLICATES * len(points):  # before a list of pairs
        raise ValueError("many of its vertices nearly coincide")
    pairs = tree.query_pairs(radius, output_type="ndarray")
    n = len(points)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    label, n = part[point.ravel()], len(vertices)
    used = np.zeros(n, dtype=bool)
    used[triangles] = True
    first = np.full(n, n)
    np.minimum.at(first, label[used], np.flatnonzero(used))
    kept = np.unique(first[first < n])
    new = np.full(n, -1)
    new[kept] = np.arange(len(kept))
    return vertices[kept], new[first[label[triangles]]]


def write_ply(
    path: Path,
    points: np.ndarray,  # (k, 3)
    # mapping of (k,) array, properties of the points after x, y, z
    values: Mapping[str, np.ndarray],
    triangles: np.ndarray | None = None,  # (m, 3) int
    comment: str = "",  # one line
) -> None:
    """Write little-endian PLY in double precision."""
    names = ["x", "y", "z", *values]
    vertices = np.empty(len(points), dtype=[(name, "<f8") for name in names])
    for name, column in zip(names, [*points.T, *values.values()], strict=True):
        vertices[name] = column
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {comment}"] if comment else []
    header += [f"element vertex {len(points)}", *(f"property double {name}" for name in names)]
    body = vertices.tobytes()
    if triangles is not None:
        header += [
            f"element face {len(triangles)}",
            "property list uchar int vertex_indices",
        ]
        faces = np.empty(len(triangles), dtype=[("count", "u1"), ("nodes", "<i4", 3)])
        faces["count"], faces["nodes"] = 3, triangles
        body += faces.tobytes()
    path.write_bytes(("\n".join([*header, "end_header"]) + "\n").encode("ascii") + body)
