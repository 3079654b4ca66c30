"""An untouched rubber membrane under pressures of one's choice."""

from __future__ import annotations

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factor, Factoriser

_AIM = 1e-9  # largest force left at a node over the largest load on one
_STEPS = 40
_FLATTEST = 1e-4  # share of the slope by which the energy must fall for a step to be taken (Armijo)
_SMALLEST_STEP = 0.005  # step over the pressure wanted below which an equilibrium is given up


class Inflation:
    """Equilibria of a membrane that nothing touches."""

    def __init__(
        self,
        membrane: RubberMembrane,
        # (n, 3), forces f on the nodes beside the gas's: those that hold the reference surface
        # where not given, 0 for a membrane whose mesh is not the equilibrium
        rest_force_n: np.ndarray | None = None,
    ) -> None:
        self.membrane = membrane
        self._rest = membrane.rest_force if rest_force_n is None else rest_force_n
        self._factoriser = Factoriser(membrane.tangent(membrane.mesh.nodes, 0.0))

    def at(self, pressure_pa: float, near: np.ndarray | None = None) -> np.ndarray:
        """Nodes (n, 3) in m under a gauge pressure.

        Newton's method down the energy from `near` or else from the reference surface, in steps of
        pressure that shrink where they fail.

        Raises SolveError: no stable equilibrium: the pressure is beyond the membrane's limit.
        """
        found = None if near is None else self._solve(pressure_pa, near)
        if found is not None:
            return found
        x, now = self.membrane.mesh.nodes, self.membrane.gauge_pressure_pa
        left = step = pressure_pa - now
        while abs(step) >= _SMALLEST_STEP * abs(pressure_pa) or step == left:
            found = self._solve(now + step, x)
            if found is None:
                step *= 0.5
                continue
            x, now = found, now + step
            if step == left:
                return x
            left = step = pressure_pa - now
        raise SolveError(
            f"membrane: no equilibrium under {pressure_pa:.4g} Pa; it is beyond what this rubber"
            " can hold"
        )

    def motions(self, x: np.ndarray, pressure_pa: float, forces_n: np.ndarray) -> np.ndarray:
        """Motions (k, n, 3) in m from an equilibrium under further small forces (k, n, 3)."""
        moving = self.membrane.moving
        right = forces_n[:, moving].reshape(len(forces_n), -1).T
        out = np.zeros_like(forces_n)
        solved = self._factor(x, pressure_pa).solve(np.ascontiguousarray(right))
        out[:, moving] = solved.T.reshape(len(forces_n), -1, 3)
        return out

    def _factor(self, x: np.ndarray, pressure_pa: float) -> Factor:
        return self._factoriser.factor(self.membrane.tangent(x, pressure_pa).data)

    def _solve(self, pressure_pa: float, x: np.ndarray) -> np.ndarray | None:
        moving = self.membrane.moving
        for _ in range(_STEPS):
            load = pressure_pa * self.membrane.volume_gradient(x)
            left = (self.membrane.force(x) - load - self._rest)[moving]
            factor = self._factor(x, pressure_pa)
            stable = factor.negative_directions() == 0
            if np.abs(left).max() < _AIM * np.abs(load).max():
                return x if stable else None
            if not stable:
                return None
            motion = np.zeros_like(x)
            motion[moving] = -factor.solve(left.ravel()).reshape(-1, 3)
            slope = float(np.sum(left * motion[moving]))
            energy, length = self._energy(x, pressure_pa), 1.0
            noise = 1e-12 * abs(energy)
            while True:
                ahead = x + length * motion
                wanted = energy + _FLATTEST * length * slope + noise
                if self._energy(ahead, pressure_pa) <= wanted:
                    break
                length *= 0.5
                if length < 1e-4:
                    return None
            x = ahead
        return None

    def _energy(self, x: np.ndarray, pressure_pa: float) -> float:
        moving = self.membrane.moving
        held = float(np.sum(self._rest[moving] * x[moving]))
        return self.membrane.energy(x) - pressure_pa * self.membrane.volume(x) - held
