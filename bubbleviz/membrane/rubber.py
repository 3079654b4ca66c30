"""The exact rubber membrane: energy, forces and tangent of incompressible neo-Hookean triangles.

For a P1 triangle the neo-Hookean energy A₀ (μh/2) (tr C + 1/det C − 3) has two parts. The part with
tr C is the energy of linear springs: a constant matrix, μh times the cotangent Laplacian of the
stress-free triangle. 1/det C = (A₀/A)² depends only on the current area. The energy is thus

    W(x) = ½ xᵀ (L₀ ⊗ I) x + Σ ψ(A),   ψ(A) = ½ μh A₀³/A².

In far-stretched rubber (λ → ∞) only the springs remain; their stiffness is the paper's K. If the
nodes may slide along the surface, this is a film of constant tension: the least energy of the
springs over all positions of nodes on a surface is γ0 times its area (a conformal map).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from bubbleviz.errors import InputError
from bubbleviz.membrane.assembly import FIRST, SECOND, Assembly
from bubbleviz.membrane.mesh import MembraneMesh

FAR_STRETCHED = 1e3
"""λ in place of infinity: 1/det C is then below rounding, and only the springs remain."""

FROM_EDGES = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
"""Derivatives of the shape functions of the corners along the edges from corner 0."""

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
_TURNS = ((1, 1.0), (2, -1.0), (4, 1.0))
"""Pairs of different corners, and whether the second follows the first."""


class _Facets(NamedTuple):
    """Current triangles, components first, so that a whole mesh is one array operation."""

    edges: np.ndarray  # (3, 3, m), opposite each corner, by component and corner, m
    vector: np.ndarray  # (3, m), unit normal times twice the area, m²
    height: np.ndarray  # (m,), a sixth of the sum of the corners' z, m; V = Σ vector_z × height

    @classmethod
    def of(cls, corners: np.ndarray) -> _Facets:
        """Of corner positions (component, corner, m)."""
        edges = corners.take(_LAST, axis=1) - corners.take(_NEXT, axis=1)
        vector = _cross(edges[:, 1], edges[:, 2])
        return cls(edges, vector, corners[2].sum(axis=0) / 6.0)

    @property
    def double(self) -> np.ndarray:
        """Twice the areas, (m,), m²."""
        return np.sqrt(np.einsum("im,im->m", self.vector, self.vector))

    def volume_gradient(self) -> np.ndarray:
        """Derivative of the volume by component and corner, (3, 3, m), m²."""
        parts = np.empty_like(self.edges)
        np.multiply(self.edges[1], -self.height, out=parts[0])
        np.multiply(self.edges[0], self.height, out=parts[1])
        parts[2] = self.vector[2] / 6.0
        return parts


class RubberMembrane:
    """Membrane of incompressible neo-Hookean rubber.

    Positions x are (n, 3) arrays in m in the bubble frame. Vectors and matrices over the moving
    nodes have three rows a node, in the order of `moving`.

    Raises InputError: a stress-free triangle has no area, or a number is negative or not finite.
    """

    def __init__(
        self,
        mesh: MembraneMesh,  # reference surface, under `gauge_pressure_pa`
        gauge_pressure_pa: float,  # pressure G that the reference surface holds, Pa
        # (m, 2, 2), inverse metric of the stress-free triangles, 1/m²: with the stress-free edges
        # D₀ = [X₁ − X₀, X₂ − X₀] (2×2) it is (D₀ᵀ D₀)⁻¹
        stress_free: np.ndarray,
        # float or (m,) array, shear modulus times stress-free thickness, N/m
        mu_h_n_per_m: float | np.ndarray,
        # motion of the rim, on springs, under the mean tension; None for a clamped rim
        rim_slack_m: float | None = None,
    ) -> None:
        self.mesh, self.gauge_pressure_pa = mesh, gauge_pressure_pa
        count = len(mesh.triangles)
        inverse = np.asarray(stress_free, float)
        self.mu_h = np.broadcast_to(np.asarray(mu_h_n_per_m, float), count)
        determinant = inverse[:, 0, 0] * inverse[:, 1, 1] - inverse[:, 0, 1] * inverse[:, 1, 0]
        for name, values in (("stress-free area", determinant), ("stiffness", self.mu_h)):
            if not (np.isfinite(values).all() and (values > 0.0).all()):
                raise InputError(
                    f"rubber: the {name} of a triangle is not above 0; correct prestretch and "
                    "tension in the sensor file, or remesh its surface"
                )
        self.stress_free_area = 0.5 / np.sqrt(determinant)
        self._corners = mesh.triangles.T
        self.inverse = inverse
        self._springs = self._spring_matrix()
        self.moving = mesh.free if rim_slack_m is None else np.arange(len(mesh.nodes))
        self.rim_springs = np.zeros(len(mesh.nodes))
        if rim_slack_m is not None:
            self.rim_springs = self.mean_tension / rim_slack_m * mesh.rim_lengths

    @classmethod
    def uniform(
        cls,
        # mesh, gauge_pressure_pa, rim_slack_m: as of the class
        mesh: MembraneMesh,
        gauge_pressure_pa: float,
        tension_n_per_m: float,  # γ0 = μh (1 − λ⁻⁶), N/m
        # λ: stress-free triangles are the reference ones shrunk by it. None: constant tension,
        # which is far-stretched rubber.
        prestretch: float | None = None,
        rim_slack_m: float | None = None,
    ) -> RubberMembrane:
        """Membrane of the same tension γ0 everywhere.

        Raises InputError: λ is not above 1, or γ0 not above 0.
        """
        prestretch = FAR_STRETCHED if prestretch is None else prestretch
        mu_h = shear_stiffness(tension_n_per_m, prestretch)
        stress_free = prestretch**2 * inverse_metric(mesh)
        return cls(mesh, gauge_pressure_pa, stress_free, mu_h, rim_slack_m)

    def on(
        self,
        mesh: MembraneMesh,
        parent: np.ndarray,  # (k,) int, triangle that each of the mesh's lies in
    ) -> RubberMembrane:
        """The same rubber on parts of its triangles, clamped at the border of their mesh."""
        own, finer = edges_of(self.mesh)[parent], edges_of(mesh)
        metric = own @ own.swapaxes(1, 2)
        back = np.linalg.inv(np.linalg.solve(metric, own @ finer.swapaxes(1, 2)))
        stress_free = back @ self.inverse[parent] @ back.swapaxes(1, 2)
        return RubberMembrane(mesh, self.gauge_pressure_pa, stress_free, self.mu_h[parent])

    # -- energy and forces ----------------------------------------------------------------------

    def energy(self, x: np.ndarray) -> float:
        """Stored energy W in J, up to a constant; inf where a triangle has no area."""
        area = 0.5 * self._facets(x).double
        if not (area > 0.0).all():
            return np.inf
        by_area = 0.5 * self.mu_h * self.stress_free_area**3 / area**2
        moved = x - self.mesh.nodes
        rim = self.rim_springs @ np.einsum("ij,ij->i", moved, moved)
        springs = np.einsum("ij,ij->", x, self._springs @ x)
        return float(0.5 * springs + by_area.sum() + 0.5 * rim)

    def force(self, x: np.ndarray) -> np.ndarray:
        """Gradient of `energy`, (n, 3), N: external forces at equilibrium."""
        return self._springs_pull(x) + self._gathered(self._by_area(self._facets(x)))

    @cached_property
    def rest_force(self) -> np.ndarray:
        """f_rest (n, 3), N: residual of the reference surface, assumed to be in equilibrium.

        On a clamped rim it is the rim's pull at rest.
        """
        x0 = self.mesh.nodes
        return self.force(x0) - self.gauge_pressure_pa * self.volume_gradient(x0)

    def residual(
        self,
        x: np.ndarray,  # (n, 3)
        # float or (n,) array, pressure p at the nodes, inside minus outside, Pa: gas pressure
        # change minus contact pressure
        pressure_pa: float | np.ndarray,
    ) -> np.ndarray:
        """∂W/∂x − p ∂V/∂x − f_rest, (n, 3), N: the external force needed for equilibrium."""
        facets = self._facets(x)
        parts = self._by_area(facets)
        parts -= np.broadcast_to(pressure_pa, len(x))[self._corners] * facets.volume_gradient()
        return self._springs_pull(x) + self._gathered(parts) - self.rest_force

    def residual_changes(self, others: Sequence[RubberMembrane], x: np.ndarray) -> np.ndarray:
        """Residuals at `x` of the same mesh of other materials minus its own, (n, 3, others), N.

        Each under its own gauge pressure.
        """
        facets, changes = self._facets(x), np.empty((*x.shape, len(others)))
        area, by_volume = 0.5 * facets.double, facets.volume_gradient()
        own, by_area = self._area_law(area)[0], _area_gradient(facets, 0.5)
        forces = self._springs_pull(x) - self.rest_force
        for k, other in enumerate(others):
            parts = (other._area_law(area)[0] - own) * by_area
            parts -= (other.gauge_pressure_pa - self.gauge_pressure_pa) * by_volume
            changes[..., k] = other._springs_pull(x) - other.rest_force - forces
            changes[..., k] += self._gathered(parts)
        return changes

    def stress(self, x: np.ndarray) -> np.ndarray:
        """Cauchy stress times thickness of every triangle, (m, 3, 3), N/m."""
        facets = self._facets(x)
        double = facets.double
        area, n = 0.5 * double, (facets.vector / double).T
        edges = x[self.mesh.triangles[:, 1:]] - x[self.mesh.triangles[:, :1]]  # (m, 2, 3)
        springs = self.mu_h * self.stress_free_area / area
        slope, _ = self._area_law(area)
        tangent = np.eye(3) - n[:, :, None] * n[:, None, :]
        stretched = np.einsum("tai,tab,tbj->tij", edges, self.inverse, edges)
        return springs[:, None, None] * stretched + slope[:, None, None] * tangent

    # -- volume ---------------------------------------------------------------------------------

    def volume(self, x: np.ndarray) -> float:
        """Volume under the membrane above z = 0, m³ (Eq. 7)."""
        facets = self._facets(x)
        return float(facets.vector[2] @ facets.height)

    def volume_gradient(self, x: np.ndarray) -> np.ndarray:
        """∂V/∂x, (n, 3), m²: on inner nodes the area vector that a pressure acts on."""
        return self._gathered(self._facets(x).volume_gradient())

    # -- tangent --------------------------------------------------------------------------------

    def tangent(
        self,
        x: np.ndarray,  # (n, 3)
        pressure_pa: float | np.ndarray,  # float or (n,) array, as of `residual`
    ) -> sparse.csc_array:
        """Exact derivative of `residual` over the moving nodes, (3f, 3f), N/m.

        Symmetric where the pressure is the same everywhere. The gas law is not in it: it adds
        β g gᵀ with g = ∂V/∂x and β = −dp/dV. The matrices of all calls share their indices.
        """
        pattern, blocks = self._assembly, self._area_blocks(x)
        if np.ndim(pressure_pa):
            row_pressure = np.asarray(pressure_pa, float)[self.moving][pattern.indices // 3]
            data = pattern.assembled(blocks)
            data -= row_pressure * pattern.assembled(self._volume_blocks(x))
        else:
            blocks -= pressure_pa * self._volume_blocks(x)
            data = pattern.assembled(blocks)
        data += self._constant
        size = 3 * len(self.moving)
        return sparse.csc_array((data, pattern.indices, pattern.indptr), shape=(size, size))

    def _area_blocks(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives of Σ ψ(A) by pair of corners and components, (6, 3, 3, m), N/m.

        ∂²A/∂x_a∂x_b = A (e_a e_bᵀ − e_b e_aᵀ + (e_a·e_b) n nᵀ) with e_a = ∇φ_a.
        """
        facets = self._facets(x)
        double = facets.double
        area, n = 0.5 * double, facets.vector / double
        e = _cross((n / double)[:, None], facets.edges).swapaxes(0, 1)
        slope, bend = self._area_law(area)
        k = slope * area
        first, second = e[FIRST], e[SECOND]
        blocks = first[:, :, None] * (bend * area**2 * second)[:, None]
        blocks += (k * np.einsum("pim,pim->pm", first, second))[:, None, None] * (n[:, None] * n)
        turn = 0.5 * slope * n  # k (e_a e_bᵀ − e_b e_aᵀ) for b after a: e_a × e_b = n/(2A)
        for pair, sign in _TURNS:
            for i, j, normal in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
                blocks[pair, i, j] += sign * turn[normal]
                blocks[pair, j, i] -= sign * turn[normal]
        return blocks

    def _volume_blocks(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives of the volume, laid out as the area's, m."""
        edges, _, height = self._facets(x)
        blocks = np.zeros((6, 3, 3, len(height)))
        sixth = np.stack([-edges[1], edges[0]], axis=1) / 6.0  # (corner, component, m)
        blocks[:, :2, 2] = sixth[FIRST]
        blocks[:, 2, :2] = sixth[SECOND]
        for pair, sign in _TURNS:
            blocks[pair, 0, 1] = sign * height
            blocks[pair, 1, 0] = -sign * height
        return blocks

    @property
    def _assembly(self) -> Assembly:
        mesh = self.mesh
        return mesh.inner_assembly if len(self.moving) == len(mesh.free) else mesh.full_assembly

    @cached_property
    def _constant(self) -> np.ndarray:
        """The part of the tangent's data that does not depend on positions: the springs."""
        springs = (self._springs + sparse.diags_array(self.rim_springs)).tocsr()
        indices, indptr = self._assembly.indices, self._assembly.indptr
        columns = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        nodes = self.moving[indices // 3], self.moving[columns // 3]
        same = indices % 3 == columns % 3
        return np.where(same, np.asarray(springs[nodes]).ravel(), 0.0)

    # -- helpers --------------------------------------------------------------------------------

    def _springs_pull(self, x: np.ndarray) -> np.ndarray:
        """Force of the springs, those of the rim included, (n, 3), N."""
        return self._springs @ x + self.rim_springs[:, None] * (x - self.mesh.nodes)

    def _facets(self, x: np.ndarray) -> _Facets:
        corners = np.ascontiguousarray(x.T).take(self._corners.ravel(), axis=1)
        return _Facets.of(corners.reshape(3, 3, -1))

    def _by_area(self, facets: _Facets) -> np.ndarray:
        """Gradient of Σ ψ(A) by component and corner, (3, 3, m), N."""
        with np.errstate(divide="ignore", invalid="ignore"):
            slope, _ = self._area_law(0.5 * facets.double)
            return _area_gradient(facets, 0.5 * slope)

    def _spring_matrix(self) -> sparse.csr_array:
        """L₀ (n, n), N/m: μh times the cotangent Laplacian of the stress-free triangles."""
        element = np.einsum("ia,tij,jb->tab", FROM_EDGES, self.inverse, FROM_EDGES)
        element *= (self.mu_h * self.stress_free_area)[:, None, None]
        t = self.mesh.triangles
        rows, columns = np.repeat(t, 3, axis=1).ravel(), np.tile(t, (1, 3)).ravel()
        n = len(self.mesh.nodes)
        return sparse.coo_array((element.ravel(), (rows, columns)), shape=(n, n)).tocsr()

    @property
    def mean_tension(self) -> float:
        """Mean tension of the reference surface, N/m."""
        # half the trace of `stress` times the area
        edges, area = edges_of(self.mesh), self.mesh.facet_areas
        stretched = np.einsum("tij,tij->t", self.inverse, edges @ edges.swapaxes(1, 2))
        springs = 0.5 * (self.mu_h * self.stress_free_area) @ stretched
        return float((springs + self._area_law(area)[0] @ area) / area.sum())

    def _area_law(self, area: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ψ′ and ψ″ of the area terms, N/m and N/m³."""
        share = self.stress_free_area / area
        rubber = self.mu_h * share * share * share  # a power takes ten times as long
        return -rubber, 3.0 * rubber / area

    def _gathered(self, parts: np.ndarray) -> np.ndarray:
        """Sums over the triangles at each node of parts (component, corner, m), (n, 3)."""
        flat, count = self._corners.ravel(), len(self.mesh.nodes)
        sums = [np.bincount(flat, part.ravel(), minlength=count) for part in parts]
        return np.stack(sums, axis=1)


def _area_gradient(facets: _Facets, half: float | np.ndarray) -> np.ndarray:
    """∂A/∂x_a = ½ n × e_a by component and corner, (3, 3, m), m, with `half` in place of ½."""
    return _cross((half / facets.double * facets.vector)[:, None], facets.edges)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products along the first axis."""
    return a[_NEXT] * b[_LAST] - a[_LAST] * b[_NEXT]


def shear_stiffness(tension_n_per_m: float, prestretch: float) -> float:
    """μh = γ0 / (1 − λ⁻⁶) of rubber stretched by λ both ways under a tension γ0, N/m.

    Raises InputError: λ is not above 1, or γ0 not above 0.
    """
    if not (np.isfinite(tension_n_per_m) and tension_n_per_m > 0.0):
        raise InputError(
            f"tension {tension_n_per_m} N/m: not a finite number above 0; correct tension or gauge "
            "pressure in the sensor file"
        )
    if not (np.isfinite(prestretch) and prestretch > 1.0):
        raise InputError(f"prestretch {prestretch}: give a finite number above 1, or leave it out")
    return tension_n_per_m / (1.0 - prestretch**-6)


def inverse_metric(mesh: MembraneMesh) -> np.ndarray:
    """Inverse metric of the mesh's own triangles, (m, 2, 2), 1/m²; see `RubberMembrane`."""
    edges = edges_of(mesh)
    return np.linalg.inv(edges @ edges.swapaxes(1, 2))


def edges_of(mesh: MembraneMesh) -> np.ndarray:
    """Edges of the triangles from corner 0 to 1 and to 2, (m, 2, 3), m."""
    corners = mesh.nodes[mesh.triangles]
    edges: np.ndarray = corners[:, 1:] - corners[:, :1]
    return edges
