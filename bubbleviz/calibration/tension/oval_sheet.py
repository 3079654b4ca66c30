"""What statics leaves open of the mean tension: that of a sheet which was flat over the same rim.

Over a round rim shape and pressure determine the stress. Over an oval one fields that pull on the
rim alone remain: a bulged flat sheet is tighter across the oval than along it, a film is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.rubber_model.inflation import Inflation
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane, inverse_metric
from bubbleviz.membrane.stiffness import mean_curvature

_PRESTRETCH = 1.005
"""λ of that sheet: the slacker it was, the more it differs from a film."""
_NEAR = 0.02
"""Share of the height to which the sheet is inflated."""
_ROUNDS = 12  # pressures tried for that height


def sheet_excess(mesh: MembraneMesh) -> float:
    """Mean tension of a sheet that was flat over its tension by balance, less 1.

    Parameters
    ----------
    mesh : MembraneMesh
        Surface whose rim and height the sheet has.

    Returns
    -------
    float
        0 where the surface overhangs its rim, so that no sheet lies below it.
    """
    flat = replace(mesh, nodes=mesh.nodes * [1.0, 1.0, 0.0])
    if not (flat.facet_vectors[:, 2] > 0.0).all():
        return 0.0
    rubber = RubberMembrane(flat, 0.0, _PRESTRETCH**2 * inverse_metric(flat), 1.0)
    inflation = Inflation(rubber, np.zeros_like(flat.nodes))
    height = float(mesh.nodes[:, 2].max())
    x, held = flat.nodes, 0.0
    stretch = _PRESTRETCH * float(np.sqrt(mesh.facet_areas.sum() / flat.facet_areas.sum()))
    pressure = mean_curvature(mesh) * (1.0 - stretch**-6)  # as if all were stretched alike
    for _ in range(_ROUNDS):
        try:
            x, held = inflation.at(pressure, x), pressure
        except SolveError:
            pressure *= 0.7
            continue
        missing = height / float(x[:, 2].max())
        if abs(missing - 1.0) < _NEAR:
            break
        pressure *= float(np.clip(missing, 0.6, 1.5))
    bulged = replace(flat, nodes=x)
    half_trace = 0.5 * np.trace(rubber.stress(x), axis1=1, axis2=2)
    mean = float(half_trace @ bulged.facet_areas / bulged.facet_areas.sum())
    return mean * mean_curvature(bulged) / held - 1.0
