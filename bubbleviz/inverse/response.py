"""Membrane with the gas behind it: equilibrium under contact, and its linearisation.

Two materials: rubber (`RubberBubble`), and constant tension with displacement
along the normals, the paper's (`ConstantTension`), whose tangent is the same everywhere.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property

import numpy as np
from scipy import sparse

from bubbleviz.membrane import (
    Factor,
    Factoriser,
    Gas,
    MembraneMesh,
    RubberMembrane,
    cotangent_laplacian,
    mean_curvature,
    symmetric_lu,
)

BALANCED_MOTION = 2e-3
"""Tolerance of equilibrium: motion of a node by the last Newton step over the mesh edge, a tenth of
that below which a frame has converged."""
_NEWTON, _FRESH = 16, 2
"""Newton steps to equilibrium under a contact pressure, and how many of them may factorise a new
tangent."""
_SLOW = 0.6
"""A step that leaves more than this share of the residual is followed by one with a new tangent,
whose factorisation takes as long as some fifteen steps."""


class Tangent(ABC):
    """Linearised motion of a membrane and the gas behind it at a shape.

    Under forces f the membrane moves by S f; a contact pressure p_c adds the forces −p_c∘a with
    a = ∂V/∂x.

    Attributes
    ----------
    x : (n, 3) array
        Shape, m.
    area_vectors : (n, 3) array
        a of the nodes, m².
    with_gas : bool
        Whether it includes the gas law; False for a measured gas pressure.
    model_error : float
        Relative standard deviation of forces by this model of the material, in any direction.
    """

    x: np.ndarray
    area_vectors: np.ndarray
    with_gas: bool
    model_error = 0.0

    def by_material(self, x: np.ndarray) -> np.ndarray:
        """Motion of a shape for one standard deviation of each material parameter, (3n, m), m."""
        return np.zeros((x.size, 0))

    @cached_property
    def bulge(self) -> np.ndarray:
        """Motion under unit gas pressure, (n, 3), m/Pa."""
        return self.motion(self.area_vectors)

    @abstractmethod
    def motion(self, force: np.ndarray) -> np.ndarray:
        """S f for forces (n, 3) in N, or several (n, 3, k): motion of the same shape, m."""

    @abstractmethod
    def adjoint(self, force: np.ndarray) -> np.ndarray:
        """Adjoint of the response to pressures, for forces (n, 3): aᵀ Sᵀ f, (n,)."""

    @abstractmethod
    def responses(self, nodes: np.ndarray) -> np.ndarray:
        """S a_j for unit pressures at nodes (c,), (3n, c), m/Pa; each is solved for once."""

    def coordinates(self, nodes: np.ndarray) -> np.ndarray:
        """`responses` in the membrane's own coordinates, (m, c): all nodal ones, or fewer."""
        return self.responses(nodes)

    def moved(self, coordinates: np.ndarray) -> np.ndarray:
        """Motion (n, 3) for coordinates (m,), m."""
        return coordinates.reshape(-1, 3)

    def by_coordinates(self, jacobian: sparse.csr_array) -> sparse.csr_array:
        """Derivative (k, m) by the coordinates, from one by the nodes (k, 3n)."""
        return jacobian


class LinearisedRubber(Tangent):
    """Factorised tangent of rubber and gas at a shape: S = (K + β a aᵀ)⁻¹.

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
        self.x, self._nodes = x, len(x)
        self.area_vectors = membrane.volume_gradient(x)
        self._factor = factoriser.factor(membrane.tangent(x, pressure_pa).data)
        self._a = self.area_vectors.ravel()
        self._beta, self.with_gas = gas_stiffness, gas_stiffness != 0.0
        self._normal = _Columns(self._nodes, 1)
        self._tangential = _Columns(self._nodes, 2)

    def by_material(self, x: np.ndarray) -> np.ndarray:
        """Motion S f for the residual forces f of each variant at `x`, (3n, variants), m.

        The tangent of a light touch is that of the membrane at rest, where these forces are 0.
        """
        if not self._variants:
            return super().by_material(x)
        residuals = self._membrane.residual_changes(self._variants, x)
        return self.motion(residuals).reshape(3 * self._nodes, -1)

    @cached_property
    def bulge(self) -> np.ndarray:
        """Motion under unit gas pressure, (n, 3), m/Pa."""
        share = self._gas_share(self._by_gas) * (self._a @ self._by_gas)
        return (self._by_gas - share * self._by_gas).reshape(-1, 3)

    def motion(self, force: np.ndarray) -> np.ndarray:
        """S f for forces (n, 3) in N, or several (n, 3, k): motion of the same shape, m."""
        out = self._factor.solve(force.reshape(len(self._a), *force.shape[2:]))
        if self._beta:
            share = self._gas_share(self._by_gas) * (self._a @ out)
            out -= np.multiply.outer(self._by_gas, share)
        return out.reshape(force.shape)

    def adjoint(self, force: np.ndarray) -> np.ndarray:
        """Adjoint of the response to pressures, for forces (n, 3): aᵀ Sᵀ f, (n,)."""
        out = self._factor.solve(force.ravel(), transposed=True)
        if self._beta:
            by_gas = self._by_gas_transposed
            out -= self._gas_share(by_gas) * (self._a @ out) * by_gas
        return np.einsum("ij,ij->i", out.reshape(-1, 3), self.area_vectors)

    @cached_property
    def _by_gas(self) -> np.ndarray:
        """K⁻¹ a, (3n,)."""
        return self._factor.solve(self._a)

    @cached_property
    def _by_gas_transposed(self) -> np.ndarray:
        """K⁻ᵀ a, (3n,)."""
        return self._factor.solve(self._a, transposed=True)

    def _gas_share(self, by_gas: np.ndarray) -> float:
        """β / (1 + β aᵀ K⁻¹ a), by Sherman and Morrison."""
        return self._beta / (1.0 + self._beta * float(self._a @ by_gas))

    def responses(self, nodes: np.ndarray) -> np.ndarray:
        """S a_j for unit pressures at nodes (c,), (3n, c), m/Pa; each is solved for once."""
        return self._normal.of(nodes, self._to_forces(self.area_vectors[:, None]))

    @cached_property
    def tangents(self) -> np.ndarray:
        """Two vectors orthogonal to each node's area vector and as long, (n, 2, 3), m²."""
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
    """Cache of solved columns, the same number for each node.

    Parameters
    ----------
    nodes : int
    each : int
        Columns of a node.
    """

    def __init__(self, nodes: int, each: int) -> None:
        self._place = np.full(nodes, -1)
        self._rows: np.ndarray = np.empty((0, each, 0))
        self._count = 0

    def of(self, nodes: np.ndarray, solved: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Columns of nodes (c,), (…, each c); missing ones are solved for."""
        new = nodes[self._place[nodes] < 0]
        if len(new):
            added = solved(new).reshape(-1, len(new), self._rows.shape[1])
            if not self._count:
                self._rows = np.empty((0, self._rows.shape[1], len(added)))
            self._reserve(self._count + len(new))
            self._place[new] = self._count + np.arange(len(new))
            self._count += len(new)
            self._rows[self._place[new]] = added.transpose(1, 2, 0)
        rows = self._rows[self._place[nodes]]
        return rows.reshape(-1, rows.shape[2]).T

    def _reserve(self, count: int) -> None:
        """Reserve memory by doubling: a frame may add a few columns."""
        room, *shape = self._rows.shape
        if count > room:
            rows = np.empty((max(count, 2 * room), *shape))
            rows[: self._count] = self._rows[: self._count]
            self._rows = rows


class Bubble(ABC):
    """A membrane and the gas behind it.

    Contact forces are a pressure (n,) in Pa along the current normals, and where there is friction
    forces (n, 3) in N that keep their direction. A gas pressure p_v of None follows from the
    volume.

    Attributes
    ----------
    mesh : MembraneMesh
    gas : Gas
        P0 and V0 of the reference configuration.
    held_pressure_pa, gauge_sigma_pa : float
        Gauge pressure of the reference configuration, and its standard deviation, Pa.
    tension_n_per_m : float
        Its mean tension.
    moving : (n,) bool array
        Nodes that are not fixed.
    caveat : str
        How wrong forces by this material may be, in one clause; empty for rubber.
    """

    mesh: MembraneMesh
    gas: Gas
    held_pressure_pa: float
    gauge_sigma_pa = 0.0
    tension_n_per_m: float
    moving: np.ndarray
    caveat = ""

    def with_gas(self, gas: Gas) -> Bubble:
        """The same membrane over another gas of the same volume."""
        other = copy(self)
        other.gas = gas
        return other

    @abstractmethod
    def area_vectors(self, x: np.ndarray) -> np.ndarray:
        """Area vectors a = ∂V/∂x at a shape, (n, 3), m²."""

    @abstractmethod
    def volume_change(self, x: np.ndarray) -> float:
        """Volume change since the reference configuration, m³."""

    def gas_at(self, x: np.ndarray) -> tuple[float, float]:
        """p_v, Pa, and −dp/dV, Pa/m³, by the gas law."""
        return self.gas.at(max(self.volume_change(x), (1e-6 - 1.0) * self.gas.V0))

    def rim_pull(self, x: np.ndarray) -> np.ndarray:
        """Pull of a shape in equilibrium on the slack of its rim, (n, 3), N."""
        return np.zeros_like(x)

    @abstractmethod
    def residual(
        self,
        x: np.ndarray,
        pressure: np.ndarray,
        gas: float | None,
        force: np.ndarray | None = None,
    ) -> np.ndarray:
        """Residual forces of equilibrium at the nodes, (n, 3), N."""

    @abstractmethod
    def linearised(self, x: np.ndarray, pressure: np.ndarray, gas: float | None) -> Tangent:
        """Tangent at a shape; RuntimeError where it is singular."""

    def equilibrium(
        self,
        tangent: Tangent,
        x: np.ndarray,
        pressure: np.ndarray,
        gas: float | None,
        force: np.ndarray | None = None,
    ) -> tuple[np.ndarray, bool, Tangent]:
        """Equilibrium near a shape by Newton's method; whether it converged; the last tangent."""
        edge, last, fresh = self.mesh.edge_length, np.inf, 0
        for _ in range(_NEWTON):
            residual = self.residual(x, pressure, gas, force)
            size = float(np.abs(residual[self.moving]).max())
            if not np.isfinite(size):
                break
            if size > _SLOW * last:
                if fresh == _FRESH:
                    break
                tangent = self.linearised(x, pressure, gas)
                fresh += 1
            last = size
            motion = tangent.motion(-residual)
            length = float(np.abs(motion).max()) / edge
            x = x + motion / max(1.0, length)
            if length < BALANCED_MOTION:
                return x, True, tangent
        return x, False, tangent


class RubberBubble(Bubble):
    """Rubber.

    Parameters
    ----------
    membrane : RubberMembrane
    gas : Gas
    variants : sequence of RubberMembrane, optional
        The membrane with one material parameter each changed by its standard deviation.
    """

    def __init__(
        self, membrane: RubberMembrane, gas: Gas, variants: Sequence[RubberMembrane] = ()
    ) -> None:
        self.membrane, self.gas, self._variants = membrane, gas, tuple(variants)
        self.mesh, self.moving = membrane.mesh, membrane.moving
        self.held_pressure_pa = gauge_pa = membrane.gauge_pressure_pa
        raised = (each.gauge_pressure_pa - gauge_pa for each in variants)
        self.gauge_sigma_pa = max(raised, default=0.0)
        self.tension_n_per_m = membrane.mean_tension
        rest = membrane.mesh.nodes
        self._rest_volume = membrane.volume(rest)
        rows = (3 * membrane.moving[:, None] + np.arange(3)).ravel()
        self._factoriser = Factoriser(membrane.tangent(rest, membrane.gauge_pressure_pa), rows=rows)

    def area_vectors(self, x: np.ndarray) -> np.ndarray:
        return self.membrane.volume_gradient(x)

    def volume_change(self, x: np.ndarray) -> float:
        return self.membrane.volume(x) - self._rest_volume

    def rim_pull(self, x: np.ndarray) -> np.ndarray:
        return self.membrane.rim_springs[:, None] * (x - self.mesh.nodes)

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
        residual = self.membrane.residual(x, self.inside(x, pressure, gas))
        return residual if force is None else residual - force

    def linearised(
        self, x: np.ndarray, pressure: np.ndarray, gas: float | None
    ) -> LinearisedRubber:
        stiffness = self.gas_at(x)[1] if gas is None else 0.0
        inside = self.inside(x, pressure, gas)
        return LinearisedRubber(
            self.membrane, self._factoriser, x, inside, stiffness, self._variants
        )


class ConstantTension(Bubble):
    """The paper's membrane: γ0 L u = A (p_v − p_c), u along the normals at rest (Eq. 5).

    Friction, which acts across the normals, does not move it.

    Parameters
    ----------
    mesh : MembraneMesh
    tension_n_per_m : float
        γ0.
    gas : Gas
    model_error : float
        As of `Tangent`.
    """

    caveat = (
        "constant tension (the sensor file has no prestretch, or the solver is linear): forces on "
        "rubber are typically 24 % off, too low on stiff domes and too high in deep presses"
    )

    def __init__(
        self, mesh: MembraneMesh, tension_n_per_m: float, gas: Gas, model_error: float = 0.0
    ) -> None:
        self.mesh, self.gas, self.moving = mesh, gas, ~mesh.rim
        self.tension_n_per_m = tension_n_per_m
        self.held_pressure_pa = tension_n_per_m * mean_curvature(mesh)
        self._stiffness = self.stiffness()
        lu = symmetric_lu(self._stiffness[mesh.free][:, mesh.free].tocsc())
        factor = Factor(lu, np.arange(lu.shape[0]))
        self._tangents = {
            with_gas: NormalTangent(mesh, factor, gas.beta if with_gas else None, model_error)
            for with_gas in (False, True)
        }

    def stiffness(self) -> sparse.csr_array:
        """Forces along the normals by displacements along them, γ0 L, (n, n), N/m."""
        return self.tension_n_per_m * cotangent_laplacian(self.mesh)

    def area_vectors(self, x: np.ndarray) -> np.ndarray:
        return self._tangents[False].area_vectors

    def volume_change(self, x: np.ndarray) -> float:
        return float(self.gas.dV_du @ self._displacement(x))

    def residual(
        self,
        x: np.ndarray,
        pressure: np.ndarray,
        gas: float | None,
        force: np.ndarray | None = None,
    ) -> np.ndarray:
        mesh, change = self.mesh, self.gas_at(x)[0] if gas is None else gas
        residual = self._stiffness @ self._displacement(x) - mesh.areas * (change - pressure)
        return residual[:, None] * mesh.normals

    def linearised(self, x: np.ndarray, pressure: np.ndarray, gas: float | None) -> NormalTangent:
        return self._tangents[gas is None]

    def _displacement(self, x: np.ndarray) -> np.ndarray:
        return _along(x - self.mesh.nodes, self.mesh.normals)


class NormalTangent(Tangent):
    """Motion along the normals of a membrane of constant tension, the same at every shape.

    Parameters
    ----------
    mesh : MembraneMesh
    factor : Factor
        Of γ0 L on the free nodes.
    beta : (n,) array or None
        Gas stiffness −∂p_v/∂u, Pa/m; None where the gas pressure is measured.
    model_error : float
    """

    def __init__(
        self,
        mesh: MembraneMesh,
        factor: Factor,
        beta: np.ndarray | None,
        model_error: float,
    ) -> None:
        self._mesh, self._factor, self.with_gas = mesh, factor, beta is not None
        self.model_error = model_error
        self.x = mesh.nodes
        self.area_vectors = mesh.areas[:, None] * mesh.normals
        self._columns = _Columns(len(mesh.nodes), 1)
        areas = mesh.areas[mesh.free]
        self._by_gas = factor.solve(areas)
        # p_v that a displacement u causes, gas and all: −shareᵀu
        self._share = np.zeros_like(areas)
        if beta is not None:
            self._share = beta[mesh.free] / (1.0 + float(beta[mesh.free] @ self._by_gas))

    def motion(self, force: np.ndarray) -> np.ndarray:
        normals = self._mesh.normals.reshape(*self._mesh.normals.shape, *(force.ndim - 2) * (1,))
        return self._moved(_along(force, normals))[:, None] * normals

    def adjoint(self, force: np.ndarray) -> np.ndarray:
        free, load = self._mesh.free, _along(force, self._mesh.normals)[self._mesh.free]
        pulled = np.zeros(len(self._mesh.nodes))
        pulled[free] = self._factor.solve(load - self._share * (load @ self._by_gas))
        return self._mesh.areas * pulled

    def responses(self, nodes: np.ndarray) -> np.ndarray:
        moved = self.coordinates(nodes)
        return (self._mesh.normals[:, :, None] * moved[:, None]).reshape(-1, len(nodes))

    def coordinates(self, nodes: np.ndarray) -> np.ndarray:
        return self._columns.of(nodes, self._to_pressures)

    def moved(self, coordinates: np.ndarray) -> np.ndarray:
        return coordinates[:, None] * self._mesh.normals

    def by_coordinates(self, jacobian: sparse.csr_array) -> sparse.csr_array:
        node = jacobian.indices[::3] // 3  # three columns a node, one after the other
        along = np.einsum("ij,ij->i", jacobian.data.reshape(-1, 3), self._mesh.normals[node])
        shape = jacobian.shape[0], len(self._mesh.nodes)
        return sparse.csr_array((along, node, jacobian.indptr // 3), shape=shape)

    def _to_pressures(self, nodes: np.ndarray) -> np.ndarray:
        """Displacement (n, c) under unit pressures from inside at nodes (c,), m/Pa."""
        load = np.zeros((len(self._mesh.nodes), len(nodes)))
        load[nodes, np.arange(len(nodes))] = self._mesh.areas[nodes]
        return self._moved(load)

    def _moved(self, load: np.ndarray) -> np.ndarray:
        """Displacement under loads (n, …) along the normals, of the same shape."""
        moved, free = np.zeros_like(load), self._mesh.free
        out = self._factor.solve(load[free])
        moved[free] = out - np.multiply.outer(self._by_gas, self._share @ out)
        return moved


def _along(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Components (n, …) of vectors (n, 3, …) along normals (n, 3, …)."""
    part: np.ndarray = (vectors * normals).sum(axis=1)
    return part
