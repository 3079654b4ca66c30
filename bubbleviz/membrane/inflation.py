"""Equilibria of an exact membrane under given pressures, by Newton's method."""

from __future__ import annotations

import numpy as np

from bubbleviz.errors import SolveError
from bubbleviz.membrane.rubber import RubberMembrane
from bubbleviz.membrane.sparse_factor import Factor, Factoriser

_STEPS, _BALANCE = 30, 1e-6
"""Most steps to equilibrium, and the largest residual over the load on a node of mean area before
the last of them, which squares it."""
_SLOW = 0.3  # ratio of residuals from which a new factor takes less time than more steps; chosen
_MIN_PRESSURE_STEP = 0.005  # least step over the target pressure before it counts as failed


def settled(
    membrane: RubberMembrane,
    factoriser: Factoriser,  # of its tangents
    # float or (n,) array, pressure inside minus outside at the nodes, Pa
    pressure_pa: float | np.ndarray,
    x: np.ndarray,  # (n, 3), start, m
    factor: Factor | None = None,  # of the tangent close to it
    added_n: np.ndarray | float = 0.0,  # (n, 3), N: residual forces besides the membrane's
) -> tuple[np.ndarray, Factor] | None:
    """Stable equilibrium (n, 3), m, and the factor of its tangent; None if there is none near.

    Steps are at most a mesh edge. The tangent is factorised again at the end, and where a step
    gains less than it costs.
    """
    mesh, moving, before = membrane.mesh, membrane.moving, np.inf
    limit = _BALANCE * mesh.areas.mean() * float(np.max(np.abs(pressure_pa)))
    for _ in range(_STEPS):
        residual = (membrane.residual(x, pressure_pa) + added_n)[moving].ravel()
        largest = float(np.abs(residual).max())
        found = largest <= limit
        if factor is None or found or largest > _SLOW * before:
            try:
                factor = factoriser.factor(membrane.tangent(x, pressure_pa).data)
            except RuntimeError:  # singular
                return None
        motion = np.zeros_like(x)
        motion[moving] = -factor.solve(residual).reshape(-1, 3)
        longest = float(np.abs(motion).max())
        if not np.isfinite(longest):
            return None
        x = x + min(1.0, mesh.edge_length / max(longest, 1e-300)) * motion
        if found:
            stable = np.ndim(pressure_pa) > 0 or factor.negative_directions() == 0
            return (x, factor) if stable else None
        before = largest
    return None


class Inflation:
    """Equilibria of a membrane without contact."""

    def __init__(
        self,
        membrane: RubberMembrane,
        # (n, 3), forces f_rest at the nodes; by default those that make the reference surface an
        # equilibrium, 0 for a membrane whose mesh is not one
        rest_force_n: np.ndarray | None = None,
    ) -> None:
        self.membrane = membrane
        rest = membrane.rest_force
        self._added_n = rest - (rest if rest_force_n is None else rest_force_n)
        self._factoriser = Factoriser(membrane.tangent(membrane.mesh.nodes, 0.0))

    def at(self, pressure_pa: float, near: np.ndarray | None = None) -> np.ndarray:
        """Nodes (n, 3) in m under a gauge pressure.

        Solved from `near`, or else from the reference surface in steps of pressure that are
        shortened on failure.

        Raises SolveError: no stable equilibrium: the pressure is beyond the membrane's limit.
        """
        found = None if near is None else self._solve(pressure_pa, near)
        if found is not None:
            return found
        x, now = self.membrane.mesh.nodes, self.membrane.gauge_pressure_pa
        remaining = step = pressure_pa - now
        while abs(step) >= _MIN_PRESSURE_STEP * abs(pressure_pa) or step == remaining:
            found = self._solve(now + step, x)
            if found is None:
                step *= 0.5
                continue
            x, now = found, now + step
            if step == remaining:
                return x
            remaining = step = pressure_pa - now
        raise SolveError(
            f"membrane: no equilibrium at a gauge pressure of {pressure_pa:.4g} Pa; lower it, or "
            "correct tension and prestretch in the sensor file"
        )

    def _solve(self, pressure_pa: float, x: np.ndarray) -> np.ndarray | None:
        found = settled(self.membrane, self._factoriser, pressure_pa, x, added_n=self._added_n)
        return None if found is None else found[0]
