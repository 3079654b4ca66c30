"""The membrane frame by frame for ParaView."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.output.deformed_shape import Shape
from bubbleviz.output.vtp_writer import write_pvd, write_series, write_vtp
from bubbleviz.pipeline import Product
from bubbleviz.result import Result


class VtkExporter:
    """Writes NAME_000012.vtp for each frame, and NAME.pvd and NAME.vtp.series that list them.

    Nodal fields: `displacement_m`, `displacement_vector_m` (from the reference surface),
    `contact_pressure_pa`, and `patch`, 1 inside.

    Parameters
    ----------
    folder : Path
    name : str
    mesh : MembraneMesh
    """

    products: frozenset[Product] = frozenset({"estimate", "patch"})

    def __init__(self, folder: Path, name: str, mesh: MembraneMesh) -> None:
        self._folder, self._name, self._mesh = folder, name, mesh
        self._names: list[str] = []
        self._times: list[float] = []

    def add(self, result: Result) -> None:
        """Write the membrane of the next frame."""
        if result.patch is None:
            raise ValueError("the product patch was not asked for")
        shape = Shape.of(self._mesh, result)
        fields = {
            "displacement_m": shape.displacement_m,
            "displacement_vector_m": shape.points_m - self._mesh.nodes,
            "contact_pressure_pa": shape.contact_pressure_pa,
            "patch": result.patch.node_mask.astype(np.uint8),
        }
        name, time_s = f"{self._name}_{result.frame.index:06d}.vtp", result.frame.time_s
        write_vtp(self._folder / name, shape.points_m, self._mesh.triangles, fields, time_s)
        self._names.append(name)
        self._times.append(time_s)

    def finish(self) -> None:
        """Write the indices."""
        write_pvd(self._folder / f"{self._name}.pvd", self._names, self._times)
        write_series(self._folder / f"{self._name}.vtp.series", self._names, self._times)
