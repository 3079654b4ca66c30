"""Units in which the inverse problem is of order one, whatever the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh


@dataclass(frozen=True)
class Scales:
    """Length a and pressure γ0/a: u/a, p a/γ0 and A/a² are dimensionless.

    Attributes
    ----------
    length_m : float
        Radius of the disc with the membrane's area.
    pressure_pa : float
        Pressure that deflects the membrane by about its own size.
    """

    length_m: float
    pressure_pa: float

    @classmethod
    def of(cls, mesh: MembraneMesh, tension_n_per_m: float) -> Scales:
        """Scales of a membrane with tension γ0."""
        length = float(np.sqrt(mesh.facet_areas.sum() / np.pi))
        return cls(length, tension_n_per_m / length)
