"""PLY files: any element and property order, ASCII or binary of either byte order.

By hand because the readers at hand refuse files that are right: trimesh binary files that mix
triangles with other polygons, VTK faces before vertices, Open3D x, y, z in another order. And
trimesh takes an ASCII file that was cut off for a whole one, and a quarter of a second to import.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

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
"""Name, type, and type of the length where it is a list."""
_Element = tuple[str, int, list[_Property]]  # name, number of rows, properties
_Columns = Mapping[str, np.ndarray | list[np.ndarray]]
"""The values of each row by property: one, or as many as a list has."""


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
        raise ValueError("no vertices or no faces")
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
    """Whether the file is ASCII, which is read as doubles throughout, and its elements."""
    formats = [_ORDERS.get(words[1]) for words in lines if words[0:1] == ["format"] and words[1:]]
    if not formats or formats[0] is None:
        raise ValueError("no known format line")
    order, elements = formats[0], list[_Element]()
    for words in lines:
        if words[:1] == ["element"] and len(words) == 3:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and elements:
            is_list = words[1:2] == ["list"]
            kinds = words[1 + is_list : -1]
            if len(kinds) != 1 + is_list or any(kind not in _TYPES for kind in kinds):
                raise ValueError(f"property not understood: {' '.join(words)}")
            *length, kind = [np.dtype(order + _TYPES[kind] if order else "f8") for kind in kinds]
            elements[-1][2].append((words[-1], kind, length[0] if length else None))
    return order == "", elements


def _read_element(
    properties: list[_Property], count: int, body: bytes, at: int
) -> tuple[_Columns, int]:
    """Columns of an element and where it ends; all rows at once where they have one length."""
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
    """Rows one by one, whose lists may differ in length, and where they end."""
    rows: dict[str, list[np.ndarray]] = {name: [] for name, _, _ in properties}
    for _ in range(count):
        for name, kind, length in properties:
            size = 1
            if length:
                told = _values(body, length, 1, at)[0]
                size = int(told)
                if size != told:
                    raise ValueError(f"a list of {told} values")
                at += length.itemsize
            rows[name].append(_values(body, kind, size, at))
            at += size * kind.itemsize
    return rows, at


def _values(body: bytes, kind: np.dtype, count: int, at: int) -> np.ndarray:
    if not 0 <= count <= (len(body) - at) // kind.itemsize:
        raise ValueError("truncated")
    return np.frombuffer(body, kind, count, at)
