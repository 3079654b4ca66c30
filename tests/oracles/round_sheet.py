"""A bulged round sheet by the equations of its meridian, which share nothing with our membrane."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.simulation.inflated_rubber import InflatedRubber
from tests.oracles.axial_mesh import swept_mesh
from tests.oracles.rubber_oracle import AxialRubber

_NODES = 3_000


def round_sheet(
    rim_radius_m: float, mu_h_n_per_m: float, prestretch: float, gauge_pressure_pa: float
) -> InflatedRubber:
    """A sheet that was flat, stretched by λ and bulged."""
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


def _swept(axial: AxialRubber, pressure_pa: float) -> MembraneMesh:
    return swept_mesh(replace(axial, gauge_pressure_pa=pressure_pa).rest, _NODES)
