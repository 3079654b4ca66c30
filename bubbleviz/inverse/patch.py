"""The contact patch: where the contact pressure exceeds a threshold (V-C)."""

from __future__ import annotations

import numpy as np

from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.result import Estimate, Patch


def mean_pressure(mesh: MembraneMesh, contact_pressure_pa: np.ndarray) -> float:
    """Mean contact pressure over the membrane, Aᵀp_c / ‖A‖₁, Pa."""
    return float(mesh.areas @ contact_pressure_pa / mesh.areas.sum())


def default_threshold(gauge_pressure_pa: float) -> float:
    """Half of the gauge pressure, Pa.

    Where the membrane lies on a flat or convex object it no longer bulges, so the contact carries
    at least the gas pressure (Young–Laplace with the membrane's curvature gone); elsewhere it
    carries none. Half way between the two is the least biased edge, on any mesh and at any depth.
    """
    return 0.5 * gauge_pressure_pa


def find_patch(mesh: MembraneMesh, estimate: Estimate, threshold_pa: float) -> Patch:
    """Patch of an estimate at a threshold.

    The force is that of the whole contact pressure; the centre of pressure is that of the patch,
    so that what lies below the threshold does not pull it aside.
    """
    pressure = estimate.contact_pressure_pa
    inside = pressure > max(threshold_pa, 0.0)
    load = mesh.areas * pressure
    center = np.full(3, np.nan)
    if inside.any():
        center = load[inside] @ mesh.deformed(estimate.displacement_m)[inside] / load[inside].sum()
    return Patch(
        threshold_pa=threshold_pa,
        node_mask=inside,
        force_n=-load @ mesh.normals,
        center_of_pressure_m=center,
        area_m2=area_above(mesh, pressure, max(threshold_pa, 0.0)),
    )


def area_above(mesh: MembraneMesh, field: np.ndarray, level: float) -> float:
    """Area in m² of the reference surface where a nodal field exceeds a level.

    Exact for the piecewise linear field: of a triangle with one corner above the level, the part
    beyond the level line is the product of the two cut edge fractions.
    """
    if level <= 0.0:
        return float(mesh.areas[field > 0.0].sum())
    low, middle, high = np.sort(field[mesh.triangles], axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (high - level) ** 2 / ((high - low) * (high - middle))
        two = 1.0 - (level - low) ** 2 / ((high - low) * (middle - low))
    fraction = np.select([low > level, middle > level, high > level], [1.0, two, one], 0.0)
    return float(fraction @ mesh.facet_areas)
