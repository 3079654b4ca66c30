"""Equilibrium of the exact membrane with the gas behind it under given contact forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property

import numpy as np

from bubbleviz.membrane import Factoriser, Gas, RubberMembrane

# The exact membrane linearised at a shape: how contact pressure moves it, and what it moves.


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
    variants : sequence of RubberMembrane, optional
        Of other materials, for `by_material`.

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
        variants: Sequence[RubberMembrane] = (),
    ) -> None:
        self._membrane, self._variants = membrane, variants
        self.x, self._moving, self._nodes = x, membrane.moving, len(x)
        self.area_vectors = membrane.volume_gradient(x)
        self._factor = factoriser.factor(membrane.tangent(x, pressure_pa).data)
        self._a = self.area_vectors[self._moving].ravel()
        self._beta, self.with_gas = gas_stiffness, gas_stiffness != 0.0
        self._normal = _Columns(self._nodes, 1)
        self._tangential = _Columns(self._nodes, 2)

    @cached_property
    def bulge(self) -> np.ndarray:
        """Motion under unit gas pressure, (n, 3), m/Pa."""
        return self.motion(self.area_vectors)

    @cached_property
    def by_material(self) -> np.ndarray:
        """S of the forces that each variant lacks at this shape, (3n, variants), m."""
        usual = self._membrane.residual(self.x, 0.0)
        gauge = self._membrane.gauge_pressure_pa
        lacking = [v.residual(self.x, v.gauge_pressure_pa - gauge) - usual for v in self._variants]
        if not lacking:
            return np.zeros((3 * self._nodes, 0))
        return self.motion(np.stack(lacking, axis=-1)).reshape(3 * self._nodes, -1)

    def motion(self, force: np.ndarray) -> np.ndarray:
        """S f for forces (n, 3) in N, or several (n, 3, k): motion of the same shape, m."""
        right = force[self._moving].reshape(len(self._a), -1)
        out = self._factor.solve(right)
        if self._beta:
            out -= np.outer(self._by_gas, self._gas_share(self._by_gas) * (self._a @ out))
        motion = np.zeros_like(force)
        motion[self._moving] = out.reshape(-1, *force.shape[1:])
        return motion

    def pull(self, force: np.ndarray) -> np.ndarray:
        """What unit contact pressures do against forces (n, 3): aᵀ Sᵀ f, (n,)."""
        right = force[self._moving].ravel()
        out = self._factor.solve(right, transposed=True)
        if self._beta:
            by_gas = self._by_gas_transposed
            out -= self._gas_share(by_gas) * (self._a @ out) * by_gas
        pull = np.zeros(self._nodes)
        pull[self._moving] = np.einsum(
            "ij,ij->i", out.reshape(-1, 3), self.area_vectors[self._moving]
        )
        return pull

    @cached_property
    def _by_gas(self) -> np.ndarray:
        """K⁻¹ a, (3f,)."""
        return self._factor.solve(self._a)

    @cached_property
    def _by_gas_transposed(self) -> np.ndarray:
        """K⁻ᵀ a, (3f,)."""
        return self._factor.solve(self._a, transposed=True)

    def _gas_share(self, by_gas: np.ndarray) -> float:
        """β / (1 + β aᵀ K⁻¹ a), by Sherman and Morrison."""
        return self._beta / (1.0 + self._beta * float(self._a @ by_gas))

    def responses(self, nodes: np.ndarray) -> np.ndarray:
        """S a_j for unit pressures at nodes (c,), (3n, c), m/Pa; each is solved for once."""
        return self._normal.of(nodes, self._to_forces(self.area_vectors[:, None]))

    @cached_property
    def tangents(self) -> np.ndarray:
        """Two vectors across each node's area vector and as long, (n, 2, 3), m²."""
        size = np.linalg.norm(self.area_vectors, axis=1, keepdims=True)
        normal = self.area_vectors / np.maximum(size, 1e-300)
        least = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
        first = np.cross(normal, least)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        return size[:, :, None] * np.stack([first, np.cross(normal, first)], axis=1)

    def tangential_responses(self, nodes: np.ndarray) -> np.ndarray:
        """S t for unit tractions along the `tangents` of nodes (c,), (3n, 2c), m/Pa."""
        return self._tangential.of(nodes, self._to_forces(self.tangents))

    def _to_forces(self, vectors: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Motions (3n, k c) under each of the vectors (n, k, 3) of nodes (c,)."""

        def motions(nodes: np.ndarray) -> np.ndarray:
            each = vectors.shape[1]
            unit = np.zeros((self._nodes, 3, len(nodes) * each))
            places = np.arange(len(nodes) * each)
            unit[np.repeat(nodes, each), :, places] = vectors[nodes].reshape(-1, 3)
            return self.motion(unit).reshape(3 * self._nodes, -1)

        return motions


class _Columns:
    """Columns of nodes, as many for each, kept once solved for.

    Parameters
    ----------
    nodes : int
    each : int
        Columns of a node.
    """

    def __init__(self, nodes: int, each: int) -> None:
        self._place = np.full(nodes, -1)
        self._rows: np.ndarray = np.empty((0, each, 3 * nodes))
        self._count = 0

    def of(self, nodes: np.ndarray, solved: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Columns of nodes (c,), (3n, each c); of those not known yet by solving for them."""
        new = nodes[self._place[nodes] < 0]
        if len(new):
            self._reserve(self._count + len(new))
            self._place[new] = self._count + np.arange(len(new))
            self._count += len(new)
            added = solved(new).reshape(-1, len(new), self._rows.shape[1])
            self._rows[self._place[new]] = added.transpose(1, 2, 0)
        rows = self._rows[self._place[nodes]]
        return rows.reshape(-1, rows.shape[2]).T

    def _reserve(self, count: int) -> None:
        """Make room by doubling: a frame may add a few."""
        room, *shape = self._rows.shape
        if count > room:
            rows = np.empty((max(count, 2 * room), *shape))
            rows[: self._count] = self._rows[: self._count]
            self._rows = rows


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
