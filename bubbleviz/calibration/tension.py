"""γ0 of a measured surface: Young–Laplace in a form that bumps do not bias."""

from __future__ import annotations

import numpy as np

from bubbleviz.errors import InputError
from bubbleviz.membrane.mesh import MembraneMesh
from bubbleviz.membrane.stiffness import cotangent_laplacian


def balance_tension(mesh: MembraneMesh, gauge_pressure_pa: float) -> float:
    """Tension γ0 in N/m from the balance over the whole free surface: P ΣA = γ0 Σ (L x)·n̂.

    Young–Laplace summed over the nodes. It is linear in the curvature, whose errors on a
    measured surface cancel in the sum; the least squares of γ0 (L x)·n̂ against A P
    (`young_laplace_tension`) divides by the sum of squares, which every bump makes larger: on
    the Punyo sensor it falls from 130 to 112 N/m as the mesh is refined, this stays at 132.6.
    For a spherical cap both are P R / 2.
    """
    free = mesh.free
    bending = np.einsum("ij,ij->i", cotangent_laplacian(mesh) @ mesh.nodes, mesh.normals)[free]
    total = float(bending.sum())
    if not total > 0.0:
        raise InputError("reference surface: flat or hollow, so no tension holds it; inflate it")
    return gauge_pressure_pa * float(mesh.areas[free].sum()) / total
