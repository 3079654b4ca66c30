"""Equilibrium of the exact membrane with the gas behind it under given contact forces."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from bubbleviz.inverse.linearised_rubber import LinearisedRubber
from bubbleviz.membrane.gas import Gas
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factoriser

_BALANCED = 1e-3
"""Force left at a node over the gas load on one of mean area."""
_NEWTON, _FRESH = 10, 2
"""Newton steps to equilibrium under a contact pressure, and how many of them may factorise a new
tangent."""


class RubberEquilibrium:
    """A membrane and the gas behind it.

    Contact forces are a pressure (n,) in Pa along the current normals, and where there is friction
    forces (n, 3) in N that keep their direction. A gas pressure p_v of None follows from the
    volume.

    Parameters
    ----------
    membrane : RubberMembrane
    gas : Gas
        P0 and V0 of the reference configuration.
    variants : sequence of RubberMembrane, optional
        As of `LinearisedRubber`.
    """

    def __init__(
        self, membrane: RubberMembrane, gas: Gas, variants: Sequence[RubberMembrane] = ()
    ) -> None:
        self.membrane, self.gas, self._variants = membrane, gas, tuple(variants)
        rest = membrane.mesh.nodes
        self._rest_volume = membrane.volume(rest)
        self._factoriser = Factoriser(membrane.tangent(rest, membrane.gauge_pressure_pa))
        self._load = membrane.gauge_pressure_pa * float(membrane.mesh.areas.mean())
        self._longest_m = membrane.mesh.edge_length

    def with_gas(self, gas: Gas) -> RubberEquilibrium:
        """The same membrane over another gas of the same volume."""
        other = copy(self)
        other.gas = gas
        return other

    def gas_at(self, x: np.ndarray) -> tuple[float, float]:
        """p_v, Pa, and −dp/dV, Pa/m³, by the gas law."""
        volume = max(self.gas.V0 + self.membrane.volume(x) - self._rest_volume, 1e-6 * self.gas.V0)
        pressure = self.gas.P0 * self.gas.V0 / volume
        return pressure - self.gas.P0, pressure / volume

    def inside(self, x: np.ndarray, pressure: np.ndarray, gas: float | None) -> np.ndarray:
        """Pressure from inside over that from outside at the nodes, (n,), Pa."""
        change = self.gas_at(x)[0] if gas is None else gas
        return self.membrane.gauge_pressure_pa + change - pressure

    def residual(
        self,
        x: np.ndarray,
        pressure: np.ndarray,
        gas: float | None,
        force: np.ndarray | None = None,
    ) -> np.ndarray:
        """What the forces at the nodes lack of equilibrium, (n, 3), N."""
        left = self.membrane.residual(x, self.inside(x, pressure, gas))
        return left if force is None else left - force

    def linearised(
        self, x: np.ndarray, pressure: np.ndarray, gas: float | None
    ) -> LinearisedRubber:
        """Tangent at a shape; RuntimeError where it is singular."""
        stiffness = self.gas_at(x)[1] if gas is None else 0.0
        inside = self.inside(x, pressure, gas)
        return LinearisedRubber(
            self.membrane, self._factoriser, x, inside, stiffness, self._variants
        )

    def settled(
        self,
        rubber: LinearisedRubber,
        x: np.ndarray,
        pressure: np.ndarray,
        gas: float | None,
        force: np.ndarray | None = None,
    ) -> tuple[np.ndarray, bool, LinearisedRubber]:
        """Equilibrium from close by, by Newton's method; whether it was found; the last tangent."""
        last, fresh = np.inf, 0
        for _ in range(_NEWTON):
            left = self.residual(x, pressure, gas, force)
            size = float(np.abs(left[self.membrane.moving]).max()) / self._load
            if size < _BALANCED:
                return x, True, rubber
            if not size < 1e3:
                break
            if size > 0.3 * last:
                if fresh == _FRESH:
                    break
                rubber = self.linearised(x, pressure, gas)
                fresh += 1
            last = size
            motion = rubber.motion(-left)
            x = x + min(1.0, self._longest_m / float(np.abs(motion).max())) * motion
        return x, False, rubber
