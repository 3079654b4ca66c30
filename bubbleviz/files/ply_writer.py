"""Binary PLY files of points or triangles with any number of values a point."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np


def write_ply(
    path: Path,
    points: np.ndarray,  # (k, 3)
    # mapping of (k,) array, properties of the points after x, y, z
    values: Mapping[str, np.ndarray],
    triangles: np.ndarray | None = None,  # (m, 3) int
    comment: str = "",  # one line
) -> None:
    """Little-endian PLY, double precision."""
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
