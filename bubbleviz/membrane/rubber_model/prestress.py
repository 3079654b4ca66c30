"""The stress of an inflated membrane from its shape and pressure, and its stress-free triangles.

Stress in a membrane has three components and its balance three equations, so that shape and gauge
pressure determine it, but for fields that are in balance by themselves and pull on the rim alone;
of those the least is taken. With the metric g of the surface over its map to the unit disc,

    T = g^(−1/2) S g^(−1/2),   S = γ (I + Σ z_k D_k)

with symmetric 2×2 polynomials D_k. Incompressible neo-Hookean rubber has a given stress in a
triangle when it is stretched from one stress-free triangle, which is found in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.rubber_model.disc_map import disc_map, zernike
from bubbleviz.membrane.rubber_model.rubber_membrane import FAR_STRETCHED, RubberMembrane
from bubbleviz.membrane.stiffness import mean_curvature

STRESS_DEGREE = 8
"""Of the polynomials and of the virtual displacements; 4 misses a bulged flat sheet by 2 %."""
_RIDGE = 1e-3
"""Weight of the mean square of Σ z_k D_k against that of the unbalanced load over the load: lies
between the squared singular values of what is determined, above 1e-2, and the others, below 1e-4.
"""
_FROM_EDGES = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
"""Derivatives of the shape functions along the edges from corner 0."""
_SYMMETRIC = np.array(
    [[[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [1.0, 0.0]]]
)


@dataclass(frozen=True)
class Prestress:
    """Stress of a surface that holds a gauge pressure, a smooth field on its map to the disc."""

    # (3, p), of Zernike polynomials in S, N/m: half of its trace, of its difference, and its shear
    weights: np.ndarray

    @classmethod
    def of(
        cls,
        mesh: MembraneMesh,  # the surface under the pressure
        gauge_pressure_pa: float,
        degree: int = STRESS_DEGREE,  # of the polynomials and of the virtual displacements
    ) -> Prestress:
        """Field that balances the pressure by least squares.

        Its virtual work with the load is none for all smooth displacements that spare the rim:
        facets pull at single nodes by some hundredths of the load, which cancels in those.

        Raises InputError: the surface is flat or hollow, so that no tension holds a pressure, or
        the mesh has fewer nodes than the field has unknowns.
        """
        curvature = mean_curvature(mesh)
        if not curvature > 0.0:
            raise InputError(
                "reference surface: flat or hollow, so that no tension holds its gauge pressure"
            )
        disc = disc_map(mesh)
        unit, polynomials = _fields(mesh, disc), _polynomials(mesh, disc, degree)
        moved = _virtual_displacements(mesh, disc, degree)[mesh.triangles]  # (m, 3, q)
        load = curvature * np.einsum("tx,tcq->xq", mesh.facet_vectors / 3.0, moved)
        pull = mesh.facet_areas[:, None, None] * np.einsum(
            "tax,ktab,bc->ktcx", _edges(mesh), unit, _FROM_EDGES
        )
        work = np.stack(
            [
                np.einsum("tcx,tcq->txq", each, moved).reshape(len(each), -1).T @ polynomials
                for each in pull
            ],
            axis=1,
        ).reshape(load.size, -1)
        missed = load.ravel() - work[:, 0]  # the first is S = γ I
        scale = curvature * mesh.facet_areas.sum()
        work, missed = work / scale, missed / scale
        z = np.linalg.solve(work.T @ work + _RIDGE * np.eye(work.shape[1]), work.T @ missed)
        z[0] += 1.0
        return cls(gauge_pressure_pa / curvature * z.reshape(3, -1))

    def times(self, factor: float) -> Prestress:
        """Field of the same surface under a pressure larger by a factor."""
        return Prestress(factor * self.weights)

    def on(self, mesh: MembraneMesh) -> np.ndarray:
        """Stress on any mesh of the surface, (m, 2, 2), N/m³.

        τ with T = E τ Eᵀ, by the edges E (3×2) of each triangle from its corner 0.
        """
        disc = disc_map(mesh)
        degree = round(np.sqrt(2.0 * self.weights.shape[1] + 0.25) - 1.5)  # of (d+1)(d+2)/2
        weights = self.weights @ _polynomials(mesh, disc, degree).T
        tau: np.ndarray = np.einsum("kt,ktij->tij", weights, _fields(mesh, disc))
        return tau


def prestressed(
    # mesh, gauge_pressure_pa, rim_slack_m: as of `RubberMembrane`
    mesh: MembraneMesh,
    gauge_pressure_pa: float,
    # μh. Where the stress is more than rubber of it can carry, as noise of a surface may ask of
    # far-stretched rubber, it is larger.
    mu_h_n_per_m: float,
    # found from the mesh where not given: one of a coarser mesh saves time
    field: Prestress | None = None,
    rim_slack_m: float | None = None,
) -> RubberMembrane:
    """Rubber membrane whose stress at rest follows from its shape and pressure."""
    field = field or Prestress.of(mesh, gauge_pressure_pa)
    tau = field.on(mesh)
    edges = _edges(mesh)
    metric = edges @ edges.swapaxes(1, 2)
    least = np.sqrt(np.maximum(np.linalg.det(metric @ tau), 0.0) / (1.0 - FAR_STRETCHED**-3))
    mu_h = np.maximum(mu_h_n_per_m, least)
    return RubberMembrane(
        mesh, gauge_pressure_pa, stress_free_metric(metric, tau, mu_h), mu_h, rim_slack_m
    )


def stress_free_metric(
    metric: np.ndarray,  # (m, 2, 2), M of the stressed triangles, m²
    tau: np.ndarray,  # (m, 2, 2), stress as of `Prestress.on`, N/m³
    mu_h: np.ndarray,  # (m,), N/m
) -> np.ndarray:
    """Inverse metric of the stress-free triangles, (m, 2, 2), 1/m²; see `RubberMembrane`.

    From τ = μh (M₀⁻¹/J − M⁻¹/J³) and det M₀ = det M / J²: (t₁/μh + s)(t₂/μh + s) = 1 for s = J⁻³
    and the principal tensions t₁, t₂.
    """
    share = metric @ tau / mu_h[:, None, None]
    trace, determinant = np.trace(share, axis1=1, axis2=2), np.linalg.det(share)
    s = 0.5 * (np.sqrt(trace**2 + 4.0 * (1.0 - determinant)) - trace)
    inside = tau / mu_h[:, None, None] + s[:, None, None] * np.linalg.inv(metric)
    stress_free: np.ndarray = s[:, None, None] ** (-1.0 / 3.0) * inside
    return stress_free


def _edges(mesh: MembraneMesh) -> np.ndarray:
    """Edges of the triangles from corner 0, (m, 2, 3), m."""
    corners = mesh.nodes[mesh.triangles]
    return corners[:, 1:] - corners[:, :1]


def _fields(mesh: MembraneMesh, disc: np.ndarray) -> np.ndarray:
    """τ of S = I, of its difference and of its shear, (3, m, 2, 2), 1/m²."""
    edges, on_disc = _edges(mesh), disc[mesh.triangles]
    back = np.linalg.inv((on_disc[:, 1:] - on_disc[:, :1]).swapaxes(1, 2))
    metric = back.swapaxes(1, 2) @ (edges @ edges.swapaxes(1, 2)) @ back
    values, vectors = np.linalg.eigh(metric)
    root = np.einsum("tia,ta,tja->tij", vectors, values**-0.5, vectors)
    way = back @ root
    fields: np.ndarray = np.einsum("tia,kab,tjb->ktij", way, _SYMMETRIC, way)
    return fields


def _polynomials(mesh: MembraneMesh, disc: np.ndarray, degree: int) -> np.ndarray:
    """Zernike polynomials in the triangles, (m, p)."""
    return zernike(disc[mesh.triangles].mean(axis=1), degree)


def _virtual_displacements(mesh: MembraneMesh, disc: np.ndarray, degree: int) -> np.ndarray:
    """Smooth functions that are 0 on the rim, orthonormal over the mean of the area, (n, q)."""
    at = disc[mesh.free]
    weight = np.sqrt(mesh.areas[mesh.free] / mesh.areas.sum())[:, None]
    ways = zernike(at, degree) * (1.0 - np.einsum("ij,ij->i", at, at))[:, None]
    if len(ways) < ways.shape[1]:
        raise InputError(
            f"mesh: {len(ways)} nodes inside the rim do not determine the stress of rubber; use a"
            " mesh of 100 nodes or more"
        )
    out = np.zeros((len(mesh.nodes), ways.shape[1]))
    out[mesh.free] = np.linalg.qr(weight * ways)[0] / weight
    return out
