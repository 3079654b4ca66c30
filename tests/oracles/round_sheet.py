"""An inflated round sheet by the equations of its meridian, independent of the membrane model.

And any inflated sheet on other meshes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np

from bubbleviz.membrane import (
    EllipsoidalCap,
    Inflation,
    MembraneMesh,
    RubberMembrane,
    TriangleScene,
    inverse_metric,
    mesh_cap,
)
from bubbleviz.simulation import InflatedRubber
from tests.oracles.axial_mesh import swept_mesh
from tests.oracles.rubber_oracle import AxialRubber

_NODES = 3_000


def round_sheet(
    rim_radius_m: float, mu_h_n_per_m: float, prestretch: float, gauge_pressure_pa: float
) -> InflatedRubber:
    """A flat sheet, stretched by λ and inflated."""
    axial = AxialRubber(rim_radius_m, mu_h_n_per_m, prestretch, gauge_pressure_pa)
    rest = axial.rest
    ring = rest.r_m * np.gradient(rest.s_m) * rest.stretches[:, 0]
    along, around = rest.tensions_n_per_m.T
    # κ1 + κ2 over G: along T1 κ1 + T2 κ2 = G, and 2 T1 κ2 = G holds the cap inside each circle.
    tension = float(ring.sum() / (ring @ ((3.0 - around / along) / (2.0 * along))))
    rim = rim_radius_m, rim_radius_m
    flat = swept_mesh(replace(rest, r_m=rest.s_m, z_m=np.zeros_like(rest.s_m)), _NODES)
    made = gauge_pressure_pa, mu_h_n_per_m, tension, partial(_swept, axial), flat, prestretch
    return InflatedRubber("round sheet", rim, *made)


@cache
def _swept(axial: AxialRubber, pressure_pa: float) -> MembraneMesh:
    return swept_mesh(replace(axial, gauge_pressure_pa=pressure_pa).rest, _NODES)


def rubber_on(sheet: InflatedRubber, mesh: MembraneMesh) -> RubberMembrane:
    """A sheet in equilibrium at rest, on a mesh with its nodes on the facets of `rest`."""
    place = TriangleScene(sheet.rest.nodes, sheet.rest.triangles).closest(mesh.nodes)
    corners = sheet.sheet.nodes[sheet.sheet.triangles[place.triangle]]
    flat = replace(mesh, nodes=np.einsum("ij,ijk->ik", place.barycentric, corners))
    free = sheet.sheet_stretch**2 * inverse_metric(flat)
    material = sheet.gauge_pressure_pa, free, sheet.mu_h_n_per_m
    inflation = Inflation(RubberMembrane(mesh, *material), np.zeros_like(mesh.nodes))
    bulged = replace(mesh, nodes=inflation.at(sheet.gauge_pressure_pa, mesh.nodes))
    return RubberMembrane(bulged, *material)


def resting(sheet: InflatedRubber, nodes: int) -> MembraneMesh:
    """Another mesh of a sheet at rest, with about `nodes` nodes, all on its facets."""
    height = float(sheet.rest.nodes[:, 2].max())
    mesh = mesh_cap(EllipsoidalCap.of(sheet.rim_semi_axes_m, height), nodes)
    inner = ~mesh.rim
    rays = np.zeros((int(inner.sum()), 6))
    rays[:, :2], rays[:, 2], rays[:, 5] = mesh.nodes[inner, :2], 1.0, -1.0
    met = TriangleScene(sheet.rest.nodes, sheet.rest.triangles).cast(rays)
    points = mesh.nodes.copy()
    points[inner, 2] = 1.0 - met.distance
    return replace(mesh, nodes=points)
