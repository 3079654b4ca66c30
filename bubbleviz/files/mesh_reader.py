"""Triangle meshes from PLY, OBJ, STL and VTK files, as they are in the file.

VTK is imported only for the formats that need it: it comes with the window's extra.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from bubbleviz.errors import InputError
from bubbleviz.files.ply_reader import read_ply

SUFFIXES = (".ply", ".obj", ".stl", ".vtk", ".vtp")


def read_triangles(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and triangles (m, 3) of a mesh file, in the file's own unit.

    Polygons are cut into triangles and coinciding vertices (STL has three per triangle) merged.

    Raises InputError: no such file, another format, unreadable, without triangles, or with NaN
    coordinates.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such mesh file; check the path")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: not a mesh format this reads; give {', '.join(SUFFIXES)}")
    try:
        vertices, triangles = _read(path)
    except ModuleNotFoundError:
        raise  # the command line says what to install
    except Exception as error:  # trimesh raises whatever a damaged file leads to
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: cannot be read as a mesh ({reason}); export it again") from error
    if not len(triangles):
        raise InputError(f"{path}: holds no triangles; export a surface mesh")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(f"{path}: a triangle names a vertex that is not there; export it again")
    wrong = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        raise InputError(f"{path}: vertex {wrong[0]} is not a finite number; repair the mesh")
    return _merge(vertices, triangles)


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Polygons of the file, triangulated."""
    if path.suffix.lower() in (".obj", ".stl"):
        return _read_trimesh(path)
    if path.suffix.lower() != ".ply":
        return _read_vtk(path)
    vertices, polygons = read_ply(path)
    fans = [
        np.stack([p[:, 0], p[:, k], p[:, k + 1]], axis=1)
        for p in polygons
        for k in range(1, p.shape[1] - 1)
    ]
    return vertices, np.concatenate(fans) if fans else np.zeros((0, 3), dtype=np.int64)


def _read_trimesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """OBJ and STL through trimesh, which needs a quarter of a second to load."""
    from trimesh import load_mesh

    mesh = load_mesh(path, process=False, maintain_order=True)
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def _read_vtk(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """VTK's own formats through VTK, which is there where the window is."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter

    complaints: list[str] = []
    reader = _vtk_reader(path)
    for speaker in (reader, reader.GetExecutive()):  # VTK prints errors without an observer
        speaker.AddObserver("ErrorEvent", lambda *_: complaints.append("damaged"))
        speaker.AddObserver("WarningEvent", lambda *_: None)
    reader.SetFileName(str(path))
    reader.Update()
    surface = reader.GetOutput()
    if complaints or not hasattr(surface, "GetPolys"):
        raise ValueError("damaged or of another format")
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
    """Vertices closer than 1e-7 of the mesh's size made one, unused ones dropped; order kept."""
    size = float(np.ptp(vertices, axis=0).max())
    pairs = cKDTree(vertices).query_pairs(1e-7 * size, output_type="ndarray")
    n = len(vertices)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    used = np.zeros(n, dtype=bool)
    used[triangles] = True
    first = np.full(n, n)
    np.minimum.at(first, label[used], np.flatnonzero(used))
    kept = np.unique(first[first < n])
    new = np.full(n, -1)
    new[kept] = np.arange(len(kept))
    return vertices[kept], new[first[label[triangles]]]
