"""Rigid objects: triangle meshes in the object frame O."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from bubbleviz.errors import InputError, check_choice, given_path
from bubbleviz.files import SUFFIXES, exists, presets_folder, read_triangles

_MAX_SIZE_M = 1.0  # of the bounding box; larger meshes are in millimetres
_MIN_SIZE_M = 5e-4  # of the bounding box


@dataclass(frozen=True)
class RigidObject:
    name: str
    vertices: np.ndarray  # (n, 3), in O, m
    triangles: np.ndarray  # (m, 3) int, counter-clockwise seen from outside


def load_object(
    name: str | Path | RigidObject, unit: Literal["m", "mm"] | None = None
) -> RigidObject:
    """Object from a mesh file or, if there is no such file, the preset of that name.

    A `RigidObject` is returned unchanged.

    Raises InputError: no such object; see also `object_mesh`.
    """
    if isinstance(name, RigidObject):
        return name
    path = given_path("object", name)
    if not exists(path):
        shipped = {p.stem: p for p in sorted(presets_folder("objects").glob("*.*"))}
        if path.suffix.lower() in SUFFIXES or path.stem not in shipped:
            known = ", ".join(shipped)
            missing = "file; give an existing one" if path.suffix else "object; give a mesh file"
            raise InputError(f"{name}: no such {missing}, or one of: {known}")
        path = shipped[path.stem]
    vertices, triangles = object_mesh(path, unit)
    return RigidObject(path.stem, vertices, triangles)


def merged(obj: RigidObject, most: int) -> RigidObject:
    """The object with at most this many triangles, for display: close vertices are merged."""
    vertices, triangles = obj.vertices, obj.triangles
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    cells = 64.0
    while len(triangles) > most:
        place = np.floor(cells * (obj.vertices - low) / size)
        _, cell, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
        cell = cell.reshape(-1)
        sums = [np.bincount(cell, obj.vertices[:, k], len(count)) for k in range(3)]
        vertices, triangles = np.column_stack(sums) / count[:, None], cell[obj.triangles]
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
        cells *= 0.8
    return RigidObject(obj.name, vertices, triangles)


def object_mesh(
    path: str | Path,  # PLY, OBJ, STL or VTK
    # unit of the file; None: millimetres if the name ends in `_mm`, else metres
    unit: Literal["m", "mm"] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) in m and triangles (m, 3) of an object's file.

    Raises InputError: unreadable, or larger than 1 m or smaller than 0.5 mm, so in a wrong unit.
    """
    path = Path(path)
    check_choice("--unit", unit, (None, "m", "mm"))
    vertices, triangles = read_triangles(path)
    in_mm = unit == "mm" or (unit is None and path.stem.endswith("_mm"))
    if in_mm:
        vertices = vertices * 1e-3
    size = float(np.ptp(vertices, axis=0).max())
    if size > _MAX_SIZE_M:
        millimetres = (
            "scale it or, if the file is in millimetres, choose that unit (next to the object in "
            "the Pose panel; pose --unit mm)"
        )
        advice = "scale it" if in_mm else millimetres
        raise InputError(f"{path}: the object is {size:.4g} m long, more than 1 m; {advice}")
    if size < _MIN_SIZE_M:
        metres = "if the file is in metres, set its unit to m, or rename it without _mm"
        advice = metres if in_mm else "scale the mesh to metres"
        raise InputError(f"{path}: the object is only {size:.3g} m long; {advice}")
    return vertices, triangles
