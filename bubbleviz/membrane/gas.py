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
    # standard deviation of the zero of a measured p_v, Pa
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

    def at(self, growth_m3: float, compliance: float = 0.0) -> tuple[float, float]:
        """p_v, Pa, and −dp_v/dV, Pa/m³, at a volume change; inf for a volume of 0 or less.

        With the compliance c, m³/Pa, of another volume p_v is the upper root of
        (P0 + p_v)(V + c p_v) = P0 V0.
        """
        c, volume = compliance, self.V0 + growth_m3
        if c == 0.0:
            if not volume > 0.0:
                return np.inf, np.inf
            pressure = self.P0 * self.V0 / volume
            return pressure - self.P0, pressure / volume
        both = volume + c * self.P0
        root = np.hypot(volume - c * self.P0, 2.0 * np.sqrt(c * self.P0 * self.V0))
        # Two forms of one root: the one without cancellation.
        if both > 0.0:
            change = 2.0 * self.P0 * (self.V0 - volume) / (both + root)
        else:
            change = (root - both) / (2.0 * c)
        beta = (self.P0 + change) / (volume + c * change)
        return change, beta / (1.0 + beta * c)

    def energy(self, growth_m3: float) -> float:
        """Work −∫ p_v dV done on the gas, J; inf for a volume of 0 or less."""
        if not self.V0 + growth_m3 > 0.0:
            return np.inf
        return self.P0 * (growth_m3 - self.V0 * float(np.log1p(growth_m3 / self.V0)))

    def measured_change(self, pressure_pa: float | None) -> float | None:
        """p_v of a measured absolute pressure, Pa; None without a measurement, or for NaN."""
        if pressure_pa is None or np.isnan(pressure_pa):
            return None
        return pressure_pa - self.P0

    def pressure_change(self, displacement: np.ndarray) -> float:
        """p_v in Pa at displacement u, to first order in u, as in the linear model (Eq. 6)."""
        return self.at(float(self.dV_du @ displacement))[0]

    @property
    def beta(self) -> np.ndarray:
        """−∂p_v/∂u at u = 0, shape (n,), Pa/m (Eq. 22)."""
        return self.P0 / self.V0 * self.dV_du


@dataclass(frozen=True)
class HeldPressure:
    """Gas with a pressure independent of its volume: open chamber, or measured pressure."""

    change_pa: float  # p_v

    def at(self, growth_m3: float, compliance: float = 0.0) -> tuple[float, float]:
        """p_v and −dp_v/dV, as of `Gas`."""
        return self.change_pa, 0.0

    def energy(self, growth_m3: float) -> float:
        """Work done on the gas, J."""
        return -self.change_pa * growth_m3
