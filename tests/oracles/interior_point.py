"""Eq. 23 by an interior-point method: slow, but accurate enough to verify other solvers."""

from __future__ import annotations

from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from bubbleviz.inverse import ConstantTension, Measurements
from bubbleviz.membrane import cotangent_laplacian


def interior_point(
    membrane: ConstantTension,
    ranges: Measurements,
    smoothness: sparse.sparray,
    threshold: np.ndarray,
    allowed: np.ndarray,
    gas_pa: float | None = None,
) -> np.ndarray:
    """Contact pressure (n,) on the allowed nodes, Pa, from u, p_c and p_v as unknowns.

    Pressures are in gauge pressures and displacements in millimetres.
    """
    mesh, unit_pa, unit_m = membrane.mesh, membrane.held_pressure_pa, 1e-3
    free, k = mesh.free, np.flatnonzero(allowed[mesh.free])
    n, normals = len(free), sparse.block_diag(list(mesh.normals[:, :, None]))
    D = unit_m * (ranges.jacobian @ normals).tocsc()[:, free]
    H1 = unit_pa**2 * smoothness.tocsc()[free][:, free][k][:, k]
    P = sparse.block_diag((D.T @ sparse.diags_array(ranges.weight) @ D, H1, np.zeros((1, 1))))
    q = [-D.T @ (ranges.weight * ranges.error), unit_pa * threshold[free][k], np.zeros(1)]
    scale = 1.0 / np.abs(q[0]).max()
    K = membrane.tension_n_per_m * unit_m / unit_pa * cotangent_laplacian(mesh)[free][:, free]
    A = sparse.diags_array(mesh.areas[free]).tocsc()
    law = unit_m / unit_pa * membrane.gas.beta[free] * (gas_pa is None)
    unit = mesh.areas.mean()
    rows: Any = [
        [K / unit, A[:, k] / unit, -sparse.csc_array(A.sum(axis=1)[:, None]) / unit],
        [sparse.csc_array(law[None]), None, sparse.csc_array([[1.0]])],
        [None, -sparse.eye_array(len(k)), None],
    ]
    b = np.zeros(n + 1 + len(k))
    b[n] = (gas_pa or 0.0) / unit_pa
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    result = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(P)) * scale,
        np.concatenate(q) * scale,
        sparse.csc_matrix(sparse.block_array(rows)),
        b,
        [clarabel.ZeroConeT(n + 1), clarabel.NonnegativeConeT(len(k))],
        settings,
    ).solve()
    assert result.status == clarabel.SolverStatus.Solved
    pressure = np.zeros(len(mesh.nodes))
    pressure[free[k]] = unit_pa * np.asarray(result.x)[n : n + len(k)]
    return pressure
