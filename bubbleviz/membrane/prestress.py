"""The stress of an inflated membrane from its shape and pressure, and its stress-free triangles.

Stress in a membrane has three components and its balance three equations, so that shape and gauge
pressure determine it, except for fields that balance themselves and pull only on the rim. Of these
the smallest is chosen. With the metric g of the surface over its map to the unit disc,

    T = g^(−1/2) S g^(−1/2),   S = γ (I + Σ z_k D_k)

with symmetric 2×2 polynomials D_k. Incompressible neo-Hookean rubber has a given stress in a
triangle when it is stretched from one stress-free triangle, which is found in closed form.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import eval_jacobi

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.rubber import FAR_STRETCHED, FROM_EDGES, RubberMembrane, edges_of
from bubbleviz.membrane.stiffness import mean_curvature

# Orthogonal polynomials on the unit disc, to which `MembraneMesh.disc` maps a membrane.


def zernike(at: np.ndarray, degree: int) -> np.ndarray:
    """Zernike polynomials up to a degree at points (k, 2) of the unit disc, (k, p).

    Their mean squares over the disc are 1, their mean products 0.
    """
    z = at[:, 0] + 1j * at[:, 1]
    square = np.abs(z) ** 2
    columns = []
    for m in range(degree + 1):
        turn = z**m
        for n in range(m, degree + 1, 2):
            radial = np.sqrt((n + 1.0) * (2.0 if m else 1.0))
            radial = radial * eval_jacobi((n - m) // 2, 0, m, 2.0 * square - 1.0)
            columns += [radial * turn.real, radial * turn.imag] if m else [radial]
    return np.stack(columns, axis=1)


STRESS_DEGREE = 8
"""Of the polynomials and of the virtual displacements; 4 misses a bulged flat sheet by 2 %."""
_RIDGE = 1e-3
"""Weight of the mean square of Σ z_k D_k relative to that of the unbalanced share of the load: it
lies between the squared singular values of determined combinations, above 1e-2, and of the others,
below 1e-4."""
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
        near: Prestress | None = None,  # for parts that balance leaves open; None: uniform
    ) -> Prestress:
        """Field that balances the pressure by least squares.

        Stress and load together do no virtual work in smooth displacements that are 0 on the rim.
        (At single nodes facets leave some hundredths of the load, which cancel in smooth ones.)

        Raises InputError: the surface is flat or concave, so that no tension holds a pressure, or
        the mesh has fewer nodes than the field has unknowns.
        """
        return _Balance.of(mesh, degree).field(gauge_pressure_pa, near)

    @classmethod
    def fitted(
        cls,
        mesh: MembraneMesh,
        stress: np.ndarray,  # (m, 3, 3), Cauchy stress times thickness, N/m
    ) -> Prestress:
        """Field with the least mean square difference from a stress on a surface."""
        edges = edges_of(mesh)
        across = np.linalg.solve(edges @ edges.swapaxes(1, 2), edges)
        tau = across @ stress @ across.swapaxes(1, 2)
        rows, columns = [0, 0, 1], [0, 1, 1]  # of what differs in a symmetric matrix
        fields = _fields(mesh)[:, :, rows, columns].transpose(1, 2, 0)
        parts = np.linalg.solve(fields, tau[:, rows, columns, None])[..., 0]  # (m, 3)
        weight = np.sqrt(mesh.facet_areas)[:, None]
        polynomials = _polynomials(mesh, STRESS_DEGREE)
        return cls(np.linalg.lstsq(weight * polynomials, weight * parts, rcond=None)[0].T)

    def unequal(self, mesh: MembraneMesh, gauge_pressure_pa: float) -> dict[str, Prestress]:
        """Fields without load that may be added to this one of a surface under a gauge pressure.

        The first pulls along x and pushes along y, the second is their shear, each by the mean
        tension, and only the rim holds them: a sheet stretched unequally over its rim has them.
        By the names of their amplitudes in the sensor file.
        """
        balance, fields = _Balance.of(mesh, STRESS_DEGREE), {}
        tension = gauge_pressure_pa / balance.curvature
        for part, name in enumerate(("unequal_tension_x", "unequal_tension_xy"), start=1):
            near = Prestress(self.weights.copy())
            near.weights[part, 0] += tension
            fields[name] = balance.field(gauge_pressure_pa, near).minus(self)
        return fields

    def mean_tension(self, mesh: MembraneMesh) -> float:
        """Mean of half the trace over a mesh of the surface, N/m."""
        edges = edges_of(mesh)
        tension = 0.5 * np.einsum("tij,tji->t", edges @ edges.swapaxes(1, 2), self.on(mesh))
        return float(np.average(tension, weights=mesh.facet_areas))

    def plus(self, fields: Iterable[Prestress], amplitudes: list[float]) -> Prestress:
        """The field with multiples of others of the same surface."""
        added = [a * each.weights for a, each in zip(amplitudes, fields, strict=True)]
        return Prestress(self.weights + sum(added))

    def times(self, factor: float) -> Prestress:
        """Field of the same surface under a pressure larger by a factor."""
        return Prestress(factor * self.weights)

    def minus(self, other: Prestress) -> Prestress:
        """Difference from another field of the same surface."""
        return Prestress(self.weights - other.weights)

    def on(self, mesh: MembraneMesh) -> np.ndarray:
        """Stress on any mesh of the surface, (m, 2, 2), N/m³.

        τ with T = E τ Eᵀ, by the edges E (3×2) of each triangle from its corner 0.
        """
        degree = round(np.sqrt(2.0 * self.weights.shape[1] + 0.25) - 1.5)  # of (d+1)(d+2)/2
        weights = self.weights @ _polynomials(mesh, degree).T
        tau: np.ndarray = np.einsum("kt,ktij->tij", weights, _fields(mesh))
        return tau


@dataclass(frozen=True)
class _Balance:
    """Least squares of `Prestress.of`, of which only the start depends on the field `near`."""

    curvature: float  # mean, 1/m
    scale: float  # curvature times area, m
    work: np.ndarray  # (w, 3 p), virtual work of the weights
    load: np.ndarray  # (w,), of the pressure, under a unit of mean tension

    @classmethod
    def of(cls, mesh: MembraneMesh, degree: int) -> _Balance:
        curvature = mean_curvature(mesh)
        if not curvature > 0.0:
            raise InputError(
                "reference surface: flat or concave, so no tension can balance the gauge pressure; "
                "identify the inflated sensor, or correct the surface in the sensor file"
            )
        unit, polynomials = _fields(mesh), _polynomials(mesh, degree)
        moved = _virtual_displacements(mesh, degree)[mesh.triangles]  # (m, 3, q)
        load = curvature * np.einsum("tx,tcq->xq", mesh.facet_vectors / 3.0, moved)
        pull = mesh.facet_areas[:, None, None] * (FROM_EDGES.T @ unit @ edges_of(mesh))
        work = np.stack(
            [
                np.einsum("tcx,tcq->txq", each, moved).reshape(len(each), -1).T @ polynomials
                for each in pull
            ],
            axis=1,
        ).reshape(load.size, -1)
        scale = curvature * mesh.facet_areas.sum()
        return cls(curvature, scale, work, load.ravel())

    def field(self, gauge_pressure_pa: float, near: Prestress | None) -> Prestress:
        """The field nearest to another one, or to a uniform tension."""
        tension = gauge_pressure_pa / self.curvature
        start = np.eye(1, self.work.shape[1])[0]  # S = γ I
        if near is not None:
            start = near.weights.ravel() / tension
        work, missed = self.work / self.scale, (self.load - self.work @ start) / self.scale
        z = np.linalg.solve(work.T @ work + _RIDGE * np.eye(work.shape[1]), work.T @ missed)
        return Prestress(tension * (start + z).reshape(3, -1))


def prestressed(
    # mesh, gauge_pressure_pa, rim_slack_m: as of `RubberMembrane`
    mesh: MembraneMesh,
    gauge_pressure_pa: float,
    # μh. It is increased where rubber of this μh could not carry the stress, as may happen by noise
    # of the surface in far-stretched rubber.
    mu_h_n_per_m: float | np.ndarray,
    # found from the mesh where not given: one of a coarser mesh saves time, and so do its values
    field: Prestress | np.ndarray | None = None,
    rim_slack_m: float | None = None,
) -> RubberMembrane:
    """Rubber membrane whose stress at rest follows from its shape and pressure."""
    field = Prestress.of(mesh, gauge_pressure_pa) if field is None else field
    tau = field.on(mesh) if isinstance(field, Prestress) else field
    edges = edges_of(mesh)
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


def _fields(mesh: MembraneMesh) -> np.ndarray:
    """τ of S = I, of its difference and of its shear, (3, m, 2, 2), 1/m²."""
    edges, on_disc = edges_of(mesh), mesh.disc[mesh.triangles]
    back = np.linalg.inv((on_disc[:, 1:] - on_disc[:, :1]).swapaxes(1, 2))
    metric = back.swapaxes(1, 2) @ (edges @ edges.swapaxes(1, 2)) @ back
    # g^(−1/2) = ((tr g + s) I − g) / (s √(tr g + 2 s)) with s = √det g
    s, trace = np.sqrt(np.linalg.det(metric)), np.trace(metric, axis1=1, axis2=2)
    root = (trace + s)[:, None, None] * np.eye(2) - metric
    way = back @ (root / (s * np.sqrt(trace + 2.0 * s))[:, None, None])
    fields: np.ndarray = way @ _SYMMETRIC[:, None] @ way.swapaxes(1, 2)
    return fields


def _polynomials(mesh: MembraneMesh, degree: int) -> np.ndarray:
    """Zernike polynomials in the triangles, (m, p)."""
    return zernike(mesh.disc[mesh.triangles].mean(axis=1), degree)


def _virtual_displacements(mesh: MembraneMesh, degree: int) -> np.ndarray:
    """Smooth functions that are 0 on the rim, orthonormal over the mean of the area, (n, q)."""
    at = mesh.disc[mesh.free]
    weight = np.sqrt(mesh.areas[mesh.free] / mesh.areas.sum())[:, None]
    ways = zernike(at, degree) * (1.0 - np.einsum("ij,ij->i", at, at))[:, None]
    if len(ways) < ways.shape[1]:
        raise InputError(
            f"mesh: {len(ways)} nodes inside the rim are too few to determine the rubber's "
            "stress; use a mesh of 100 nodes or more (membrane.nodes in the sensor file, --nodes)"
        )
    out = np.zeros((len(mesh.nodes), ways.shape[1]))
    out[mesh.free] = np.linalg.qr(weight * ways)[0] / weight
    return out
