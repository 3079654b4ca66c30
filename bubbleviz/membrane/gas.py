"""The gas behind the membrane: ideal gas law and its linearisation (Eqs. 6, 9 and 22)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.sensor import Pneumatics


@dataclass(frozen=True)
class Gas:
    """Isothermal ideal gas in the chamber and under the cap."""

    P0: float  # absolute reference pressure, Pa
    V0: float  # reference volume, chamber and cap, m³
    # (n,), volume change per node displacement, m². The divergence theorem gives A; the paper's Eq.
    # 9 has A/3, which under-reports p_v threefold and is kept for comparison.
    dV_du: np.ndarray
    # lowest_change_pa, highest_change_pa: range of p_v that a membrane can cause: from no gauge
    # pressure left to the cap pressed flat
    lowest_change_pa: float = -np.inf
    highest_change_pa: float = np.inf
    # standard deviation of the zero from which a measured p_v counts, Pa
    zero_sigma_pa: float = 0.0

    @classmethod
    def of(cls, pneumatics: Pneumatics, mesh: MembraneMesh) -> Gas:
        """Gas of a sensor whose reference surface is `mesh`."""
        factor = 1.0 if pneumatics.volume_model == "exact" else 1.0 / 3.0
        P0, chamber = pneumatics.reference_pressure_pa, pneumatics.chamber_volume_m3
        return cls(
            P0=P0,
            V0=chamber + mesh.cap_volume(),
            dV_du=factor * mesh.areas,
            lowest_change_pa=-pneumatics.gauge_pressure_pa,
            highest_change_pa=P0 * mesh.cap_volume() / chamber,
        )

    def behind(self, mesh: MembraneMesh) -> Gas:
        """The same gas behind another mesh of the same facets."""
        return replace(self, dV_du=self.dV_du.sum() / mesh.areas.sum() * mesh.areas)

    def volume(self, displacement: np.ndarray) -> float:
        """Gas volume V in m³ at displacement u (first order in u, as the membrane is)."""
        return self.V0 + float(self.dV_du @ displacement)

    def pressure_change(self, displacement: np.ndarray) -> float:
        """Pressure change p_v = P0 V0 / V − P0 in Pa (Eq. 6); inf when no volume is left."""
        volume = self.volume(displacement)
        return self.P0 * self.V0 / volume - self.P0 if volume > 0.0 else np.inf

    @property
    def beta(self) -> np.ndarray:
        """−∂p_v/∂u at u = 0, shape (n,), Pa/m (Eq. 22)."""
        return self.P0 / self.V0 * self.dV_du
