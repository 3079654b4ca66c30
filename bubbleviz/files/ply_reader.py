"""PLY files: any element and property order, ASCII or binary of either byte order.

Our own reader because those at hand fail on files that are right: VTK crashes on faces before
vertices and reads doubles as floats, Open3D wants x, y, z in this order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
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
_FACES = ("vertex_indices", "vertex_index")


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)
    """Name, type, and type of the length where it is a list (else empty)."""


def read_ply(path: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """Vertices (n, 3) and polygons, each an int array grouped by size (k, corners).

    Raises
    ------
    ValueError
        Not a PLY, truncated, or without vertices and faces.
    """
    header, body = _split(path.read_bytes())
    order, elements = _parse_header(header)
    least = sum(e.count * (1 if order == "" else _least_size(e)) for e in elements)
    if any(e.count < 0 for e in elements) or least > len(body):
        raise ValueError("truncated")
    vertices, polygons = None, None
    tokens = body.split() if order == "" else []
    at = 0
    for element in elements:
        if order == "":
            columns, at = _read_ascii(element, tokens, at)
        else:
            columns, at = _read_binary(element, body, at, order)
        if element.name == "vertex":
            missing = [axis for axis in "xyz" if axis not in columns]
            if missing:
                raise ValueError(f"vertices without {missing[0]}")
            vertices = np.stack([np.array(columns[a], dtype=np.float64) for a in "xyz"], axis=1)
        if element.name == "face":
            polygons = next((columns[name] for name in _FACES if name in columns), None)
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


def _parse_header(lines: list[list[str]]) -> tuple[str, list[_Element]]:
    """Byte order ("" for ASCII) and elements."""
    orders = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    order, elements = None, []
    for words in lines:
        if words[:1] == ["format"] and len(words) > 1:
            order = orders.get(words[1])
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append(_Element(words[1], int(words[2])))
        elif words[:1] == ["property"] and elements:
            is_list = words[1] == "list"
            if len(words) != (5 if is_list else 3) or any(
                w not in _TYPES for w in words[1 + is_list : -1]
            ):
                raise ValueError(f"property not understood: {' '.join(words)}")
            kind, length = words[-2], words[2] if is_list else ""
            elements[-1].properties.append((words[-1], _TYPES[kind], _TYPES.get(length, "")))
    if order is None:
        raise ValueError("no known format line")
    return order, elements


def _least_size(element: _Element) -> int:
    """Bytes one row has at least, all its lists being empty."""
    return sum(np.dtype(length or kind).itemsize for _, kind, length in element.properties)


def _read_ascii(
    element: _Element, tokens: list[bytes], at: int
) -> tuple[dict[str, list[np.ndarray] | np.ndarray], int]:
    width = len(element.properties)
    if all(not length for _, _, length in element.properties):
        end = at + element.count * width
        if end > len(tokens):
            raise ValueError("truncated")
        table = np.array(tokens[at:end], dtype=np.float64).reshape(element.count, width)
        return {p[0]: table[:, k] for k, p in enumerate(element.properties)}, end
    rows: dict[str, list[np.ndarray]] = {p[0]: [] for p in element.properties}
    for _ in range(element.count):
        for name, _, length in element.properties:
            if at >= len(tokens):
                raise ValueError("truncated")
            count = int(tokens[at]) if length else 1
            at += 1 if length else 0
            if count < 0 or at + count > len(tokens):
                raise ValueError("truncated")
            rows[name].append(np.array(tokens[at : at + count], dtype=np.float64))
            at += count
    return dict(rows), at


def _read_binary(
    element: _Element, body: bytes, at: int, order: str
) -> tuple[dict[str, list[np.ndarray] | np.ndarray], int]:
    lengths = _first_lengths(element, body, at, order)
    row = np.dtype(
        [
            item
            for k, (name, kind, length) in enumerate(element.properties)
            for item in (
                [(f"#{k}", order + length), (f"{name}", order + kind, (lengths[k],))]
                if length
                else [(name, order + kind)]
            )
        ]
    )
    end = at + element.count * row.itemsize
    if end <= len(body):
        table = np.frombuffer(body, row, element.count, at)
        uniform = all(
            (table[f"#{k}"] == lengths[k]).all() for k, p in enumerate(element.properties) if p[2]
        )
        if uniform:  # nearly always: all triangles
            return {p[0]: table[p[0]] for p in element.properties}, end
    return _read_ragged(element, body, at, order)


def _first_lengths(element: _Element, body: bytes, at: int, order: str) -> list[int]:
    """Length of each list of the first row (1 where it is no list)."""
    lengths = []
    for _, kind, length in element.properties:
        count = 1
        if length:
            head = np.frombuffer(body[at : at + np.dtype(length).itemsize], order + length)
            count = int(head[0]) if element.count and len(head) else 0
            if not 0 <= count <= len(body):
                raise ValueError("truncated")
            at += np.dtype(length).itemsize
        at += count * np.dtype(kind).itemsize
        lengths.append(count)
    return lengths


def _read_ragged(
    element: _Element, body: bytes, at: int, order: str
) -> tuple[dict[str, list[np.ndarray] | np.ndarray], int]:
    """Rows of lists that differ in length, one by one."""
    rows: dict[str, list[np.ndarray]] = {p[0]: [] for p in element.properties}
    for _ in range(element.count):
        for name, kind, length in element.properties:
            count = 1
            if length:
                count = int(np.frombuffer(body, order + length, 1, at)[0])
                at += np.dtype(length).itemsize
            if count < 0 or at + count * np.dtype(kind).itemsize > len(body):
                raise ValueError("truncated")
            rows[name].append(np.frombuffer(body, order + kind, count, at))
            at += count * np.dtype(kind).itemsize
    return dict(rows), at
