"""The displayed surface: one VTK mesh that membrane, wireframe, contour and rim share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyvista as pv

from bubbleviz.diagnostics.probe import Probed
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Estimate
from bubbleviz_ui.model.units import Units


@dataclass(frozen=True)
class Shape:
    """The displayed shape of the membrane, shared by the layers that lie on it.

    Attributes
    ----------
    nodes_m, normals : (n, 3) arrays
        Deformed nodes and their normals in B.
    pressure_pa : (n,) array
        Contact pressure.
    """

    nodes_m: np.ndarray
    normals: np.ndarray
    pressure_pa: np.ndarray


class Surface:
    """Holds the vertices; changed in place, never replaced.

    Attributes
    ----------
    poly : pyvista.PolyData
        Nodes in B, m; point data `PRESSURE` in displayed units, and `LEVEL`, positive
        in the patch.
    """

    PRESSURE = "contact pressure"
    LEVEL = "patch level"

    def __init__(self, units: Units) -> None:
        self._units = units
        self._mesh: MembraneMesh | None = None
        self.poly = pv.PolyData(np.eye(3), np.array([3, 0, 1, 2]))
        self.poly.point_data[self.PRESSURE] = np.zeros(3)
        self.poly.point_data[self.LEVEL] = np.full(3, -1.0)
        self.poly.point_data["Normals"] = np.eye(3)
        self.poly.GetPointData().SetActiveNormals("Normals")

    def set_mesh(self, mesh: MembraneMesh) -> None:
        """Take the reference mesh of another sensor, at rest."""
        self._mesh = mesh
        faces = np.column_stack([np.full(len(mesh.triangles), 3), mesh.triangles])
        self.poly.point_data.clear()
        self.poly.points = mesh.nodes.astype(float)
        self.poly.faces = faces.ravel()
        self.poly.point_data[self.PRESSURE] = np.zeros(len(mesh.nodes))
        self.poly.point_data[self.LEVEL] = np.full(len(mesh.nodes), -1.0)
        self.poly.point_data["Normals"] = mesh.normals.astype(float)
        self.poly.GetPointData().SetActiveNormals("Normals")
        self.poly.GetPointData().SetActiveScalars(self.PRESSURE)

    def shape_of(self, estimate: Estimate | None, exaggeration: float = 1.0) -> Shape | None:
        """Shape bubbleviz found, its displacement drawn larger; None without an estimate."""
        self._beyond = None
        if estimate is None or self._mesh is None:
            return None
        nodes = self._mesh.deformed(exaggeration * estimate.motion_m)
        if exaggeration != 1.0:
            self._beyond = nodes - self._mesh.deformed(estimate.motion_m)
        normals = replace(self._mesh, nodes=nodes).normals
        return Shape(nodes, normals, estimate.contact_pressure_pa)

    def true_place(self, point_m: np.ndarray) -> np.ndarray:
        """Where a point (3,) of the drawn surface is without exaggeration, in B."""
        if self._beyond is None:
            return point_m
        away = np.sum((np.asarray(self.poly.points) - point_m) ** 2, axis=1)
        return point_m - self._beyond[int(np.argmin(away))]

    def drawn_node(self, place: Probed) -> np.ndarray:
        """Where the node of a place is drawn, (3,) in B."""
        if self._beyond is None:
            return place.node_m
        return place.node_m + self._beyond[place.node]

    _beyond: np.ndarray | None = None

    def draw(self, shape: Shape) -> None:
        """Move the vertices and colour them, in place."""
        self.poly.points[:] = shape.nodes_m
        self.poly.point_data["Normals"][:] = shape.normals
        self.poly.point_data[self.PRESSURE][:] = self._units.pressure.of(1.0) * shape.pressure_pa
        self.poly.GetPoints().Modified()
        self.poly.Modified()

    def mark(self, level: np.ndarray) -> None:
        """Say where the patch is: (n,), positive inside."""
        self.poly.point_data[self.LEVEL][:] = level
        self.poly.Modified()
