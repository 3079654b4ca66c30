"""A sheet that was flat over the same rim, for the stress that shape and pressure leave open.

With a round rim, shape and pressure determine the stress. With an oval rim they do not: a stress
field that loads the rim alone may be added. An inflated flat sheet is tighter across the oval than
along it, a soap film is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane import (
    Inflation,
    MembraneMesh,
    Prestress,
    RubberMembrane,
    inverse_metric,
    mean_curvature,
)

_PRESTRETCH = 1.005  # λ of the sheet: the smaller, the more it differs from a film
_HEIGHT_TOLERANCE = 0.02  # relative, of the inflated sheet
_MAX_PRESSURES = 12  # tried for that height


@dataclass(frozen=True)
class FlatSheet:
    """A sheet, flat at rest, inflated to the height of a surface with the same rim."""

    mesh: MembraneMesh
    stress_m: np.ndarray  # (m, 3, 3), stress times thickness over the gauge pressure, m

    @classmethod
    def like(cls, mesh: MembraneMesh) -> FlatSheet | None:
        """Sheet for a surface; None where that overhangs its rim, so that it was never flat."""
        flat = replace(mesh, nodes=mesh.nodes * [1.0, 1.0, 0.0])
        if not (flat.facet_vectors[:, 2] > 0.0).all():
            return None
        rubber = RubberMembrane(flat, 0.0, _PRESTRETCH**2 * inverse_metric(flat), 1.0)
        inflation = Inflation(rubber, np.zeros_like(flat.nodes))
        height = float(mesh.nodes[:, 2].max())
        x, solved_pressure = mesh.nodes, 0.0
        stretch = _PRESTRETCH * float(np.sqrt(mesh.facet_areas.sum() / flat.facet_areas.sum()))
        pressure = mean_curvature(mesh) * (1.0 - stretch**-6)  # of a uniformly stretched sheet
        for _ in range(_MAX_PRESSURES):
            try:
                x, solved_pressure = inflation.at(pressure, x), pressure
            except SolveError:
                pressure *= 0.7
                continue
            height_ratio = height / float(x[:, 2].max())
            if abs(height_ratio - 1.0) < _HEIGHT_TOLERANCE:
                break
            pressure *= float(np.clip(height_ratio, 0.6, 1.5))
        return cls(replace(flat, nodes=x), rubber.stress(x) / solved_pressure)

    @property
    def excess(self) -> float:
        """Ratio of its mean tension to its tension by force balance, less 1."""
        half_trace = 0.5 * np.trace(self.stress_m, axis1=1, axis2=2)
        mean = float(half_trace @ self.mesh.facet_areas / self.mesh.facet_areas.sum())
        return mean * mean_curvature(self.mesh) - 1.0

    def stress_on(self, mesh: MembraneMesh) -> np.ndarray:
        """Stress closest to the sheet's that balances 1 Pa on a surface, as `Prestress.on`."""
        return Prestress.of(mesh, 1.0, near=Prestress.fitted(self.mesh, self.stress_m)).on(mesh)
