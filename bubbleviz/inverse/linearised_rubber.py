"""The exact membrane linearised at a shape: how contact pressure moves it, and what it moves."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from bubbleviz.membrane.rubber_model.rubber_membrane import RubberMembrane
from bubbleviz.membrane.rubber_model.sparse_factor import Factoriser


class LinearisedRubber:
    """Factorised tangent of membrane and gas at a shape.

    Under forces f the membrane moves by S f with S = (K + β a aᵀ)⁻¹, where a = ∂V/∂x; a contact
    pressure p_c adds the forces −p_c∘a.

    Parameters
    ----------
    membrane : RubberMembrane
    factoriser : Factoriser
        Of its pattern.
    x : (n, 3) array
        Shape, m.
    pressure_pa : float or (n,) array
        From inside over that from outside, Pa.
    gas_stiffness : float
        β = −dp/dV, Pa/m³; 0 where the gas pressure is measured.

    Attributes
    ----------
    x : (n, 3) array
    area_vectors : (n, 3) array
        a of the nodes, m².
    with_gas : bool
        Whether β is in it.

    Raises
    ------
    RuntimeError
        The tangent is singular.
    """

    def __init__(
        self,
        membrane: RubberMembrane,
        factoriser: Factoriser,
        x: np.ndarray,
        pressure_pa: float | np.ndarray,
        gas_stiffness: float,
    ) -> None:
        self.x, self._moving, self._nodes = x, membrane.moving, len(x)
        self.area_vectors = membrane.volume_gradient(x)
        self._factor = factoriser.factor(membrane.tangent(x, pressure_pa).data)
        self._a = self.area_vectors[self._moving].ravel()
        self._beta, self.with_gas = gas_stiffness, gas_stiffness != 0.0
        self._known: dict[int, int] = {}
        self._columns = np.empty((3 * self._nodes, 0))

    @cached_property
    def bulge(self) -> np.ndarray:
        """Motion under unit gas pressure, (n, 3), m/Pa."""
        return self.motion(self.area_vectors)

    def motion(self, force: np.ndarray) -> np.ndarray:
        """S f for forces (n, 3) in N, or several (n, 3, k): motion of the same shape, m."""
        right = force[self._moving].reshape(len(self._a), -1)
        if self._beta:
            out = self._factor.solve_with(right, self._a, self._beta)
        else:
            out = self._factor.solve(right)
        motion = np.zeros_like(force)
        motion[self._moving] = out.reshape(-1, *force.shape[1:])
        return motion

    def pull(self, force: np.ndarray) -> np.ndarray:
        """What unit contact pressures do against forces (n, 3): aᵀ Sᵀ f, (n,)."""
        solve = self._factor.solve
        right = force[self._moving].ravel()
        out = solve(right, transposed=True)
        if self._beta:
            by_gas = solve(self._a, transposed=True)
            share = self._beta * (self._a @ out) / (1.0 + self._beta * (self._a @ by_gas))
            out = out - share * by_gas
        pull = np.zeros(self._nodes)
        pull[self._moving] = np.einsum(
            "ij,ij->i", out.reshape(-1, 3), self.area_vectors[self._moving]
        )
        return pull

    def responses(self, nodes: np.ndarray) -> np.ndarray:
        """S a_j for unit pressures at nodes (c,), (3n, c), m/Pa; each is solved for once."""
        new = np.array([j for j in nodes.tolist() if j not in self._known], int)
        if len(new):
            unit = np.zeros((self._nodes, 3, len(new)))
            unit[new, :, np.arange(len(new))] = self.area_vectors[new]
            solved = self.motion(unit).reshape(3 * self._nodes, -1)
            for j in new.tolist():
                self._known[j] = len(self._known)
            self._columns = np.hstack([self._columns, solved])
        return self._columns[:, [self._known[j] for j in nodes.tolist()]]
