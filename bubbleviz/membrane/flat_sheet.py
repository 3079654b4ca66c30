"""A sheet that was flat over the same rim, for the stress that shape and pressure leave open.

With a round rim, shape and pressure determine the stress. With an oval rim they do not: a stress
field that loads the rim alone may be added. An inflated flat sheet is tighter across the oval than
along it, a soap film is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane.inflation import Inflation
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.prestress import Prestress
from bubbleviz.membrane.rubber import RubberMembrane, inverse_metric
from bubbleviz.membrane.stiffness import mean_curvature

_PRESTRETCH = 1.005  # λ of the sheet: the smaller, the more it differs from a film
_HEIGHT_TOLERANCE = 0.02  # relative, of the inflated sheet
_MAX_PRESSURES = 12  # tried for that height


def as_flat_sheet(mesh: MembraneMesh) -> tuple[Prestress, float] | None:
    """Stress of a surface under 1 Pa that is closest to that of an inflated sheet.

    The sheet is inflated to the surface's height. With the ratio of its mean tension to that by
    force balance, minus 1. None if the surface overhangs its rim, so that it was never flat.
    """
    flat = replace(mesh, nodes=mesh.nodes * [1.0, 1.0, 0.0])
    if not (flat.facet_vectors[:, 2] > 0.0).all():
        return None
    rubber = RubberMembrane(flat, 0.0, _PRESTRETCH**2 * inverse_metric(flat), 1.0)
    inflation = Inflation(rubber, np.zeros_like(flat.nodes))
    height = float(mesh.nodes[:, 2].max())
    x, solved_pressure = mesh.nodes, 0.0
    stretch = _PRESTRETCH * float(np.sqrt(mesh.facet_areas.sum() / flat.facet_areas.sum()))
    pressure = mean_curvature(mesh) * (1.0 - stretch**-6)  # of a uniformly stretched sheet
    low, high = 0.0, np.inf  # of the pressure sought: too low a sheet; too high, or no equilibrium
    for _ in range(_MAX_PRESSURES):
        try:
            x, solved_pressure = inflation.at(pressure, x), pressure
        except SolveError:
            high, following = pressure, 0.7 * pressure
        else:
            height_ratio = height / float(x[:, 2].max())
            if abs(height_ratio - 1.0) < _HEIGHT_TOLERANCE:
                break
            low, high = (pressure, high) if height_ratio > 1.0 else (low, pressure)
            following = pressure * float(np.clip(height_ratio, 0.6, 1.5))
        # near the largest pressure that a sheet bears, its height changes much faster than pressure
        pressure = following if low < following < high else 0.5 * (low + high)
    sheet, stress = replace(flat, nodes=x), rubber.stress(x) / solved_pressure
    mean = 0.5 * np.trace(stress, axis1=1, axis2=2) @ sheet.facet_areas / sheet.facet_areas.sum()
    balanced = Prestress.of(mesh, 1.0, near=Prestress.fitted(sheet, stress))
    return balanced, float(mean) * mean_curvature(sheet) - 1.0
