"""The membrane of one frame as files hold it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.output.exporter import estimate_of, is_known
from bubbleviz.result import Result


@dataclass(frozen=True)
class Shape:
    """Deformed membrane with its nodal fields.

    Attributes
    ----------
    points_m : (n, 3) array
        x0 + u n0 (Eq. 1) in B; the reference surface for a frame about which nothing is known.
    displacement_m, contact_pressure_pa : (n,) array
        NaN for such a frame.
    """

    points_m: np.ndarray
    displacement_m: np.ndarray
    contact_pressure_pa: np.ndarray

    @classmethod
    def of(cls, mesh: MembraneMesh, result: Result) -> Shape:
        """Shape of a result that holds an estimate."""
        estimate = estimate_of(result)
        if not is_known(estimate):
            nothing = np.full(len(mesh.nodes), np.nan)
            return cls(mesh.nodes, nothing, nothing)
        points = mesh.deformed(estimate.motion_m)
        return cls(points, estimate.displacement_m, estimate.contact_pressure_pa)
